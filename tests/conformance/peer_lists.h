#pragma once

#include "conformance/peers.h"

/// The explicit lists of peers, one function per place where peers live.
namespace lacquer::test {

void add_in_process_peers(std::vector<PeerMaker<CameraPeer>>& list);
void add_in_process_peers(std::vector<PeerMaker<TurntablePeer>>& list);
void add_in_process_peers(std::vector<PeerMaker<LightsPeer>>& list);
void add_v4l2_peers(std::vector<PeerMaker<CameraPeer>>& list);
void add_loopback_peers(std::vector<PeerMaker<CameraPeer>>& list);

}  // namespace lacquer::test
