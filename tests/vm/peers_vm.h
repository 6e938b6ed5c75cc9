#pragma once

#include "conformance/peers.h"

/// Peers behind a real kernel: only inside the virtual machine of tests/vm.
namespace lacquer::test {

bool in_virtual_machine();
void add_vm_peers(std::vector<PeerMaker<CameraPeer>>& list);
void add_vm_peers(std::vector<PeerMaker<TurntablePeer>>& list);
void add_vm_peers(std::vector<PeerMaker<LightsPeer>>& list);

}  // namespace lacquer::test
