#pragma once

namespace lacquer::test {

/// Gives this process a loopback network of its own, so that two runs do not meet at GigE Vision's fixed port; where the system does not
/// allow that, waits until no other run uses the common one. Once per process, before it starts threads.
void enter_private_loopback();

}  // namespace lacquer::test
