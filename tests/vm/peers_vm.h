#pragma once

#include <chrono>
#include <thread>

#include "conformance/peers.h"
#include "libbrdf/error.h"

/// Peers behind a real kernel: only inside the virtual machine of tests/vm.
namespace lacquer::test {

bool in_virtual_machine();

/// Calls `attempt` until the kernel has made the device usable, for ten seconds.
template <typename Attempt>
auto when_there(const Attempt& attempt) {
  for (int i = 0;; ++i) {
    try {
      return attempt();
    } catch (const Error&) {
      if (i == 100) throw;
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
  }
}

void add_vm_peers(std::vector<PeerMaker<CameraPeer>>& list);
void add_vm_peers(std::vector<PeerMaker<TurntablePeer>>& list);
void add_vm_peers(std::vector<PeerMaker<LightsPeer>>& list);

}  // namespace lacquer::test
