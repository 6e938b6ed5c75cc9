#include "conformance/peer_lists.h"

#ifdef LACQUER_VM_PEERS
#include "vm/peers_vm.h"
#endif

namespace lacquer::test {

namespace {

/// Inside the virtual machine only what needs its kernel is run.
template <typename Peer>
bool only_vm_peers([[maybe_unused]] std::vector<PeerMaker<Peer>>& list) {
#ifdef LACQUER_VM_PEERS
  if (in_virtual_machine()) {
    add_vm_peers(list);
    return true;
  }
#endif
  return false;
}

}  // namespace

std::vector<PeerMaker<CameraPeer>> camera_peers() {
  std::vector<PeerMaker<CameraPeer>> list;
  if (only_vm_peers(list)) return list;
  add_in_process_peers(list);
#ifdef LACQUER_V4L2
  add_v4l2_peers(list);
#endif
#ifdef LACQUER_ARAVIS
  add_loopback_peers(list);
#endif
  return list;
}

std::vector<PeerMaker<TurntablePeer>> turntable_peers() {
  std::vector<PeerMaker<TurntablePeer>> list;
  if (only_vm_peers(list)) return list;
  add_in_process_peers(list);
  return list;
}

std::vector<PeerMaker<LightsPeer>> lights_peers() {
  std::vector<PeerMaker<LightsPeer>> list;
  if (only_vm_peers(list)) return list;
  add_in_process_peers(list);
  return list;
}

}  // namespace lacquer::test
