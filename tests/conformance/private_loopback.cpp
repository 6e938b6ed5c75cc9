#include "conformance/private_loopback.h"

#include <fcntl.h>
#include <net/if.h>
#include <sched.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>

namespace lacquer::test {

namespace {

bool bring_loopback_up() {
  const int s = socket(AF_INET, SOCK_DGRAM, 0);
  if (s < 0) return false;
  ifreq request{};
  std::strncpy(request.ifr_name, "lo", IFNAMSIZ - 1);
  bool up = ioctl(s, SIOCGIFFLAGS, &request) == 0;
  request.ifr_flags = static_cast<short>(request.ifr_flags | IFF_UP | IFF_RUNNING);
  up = up && ioctl(s, SIOCSIFFLAGS, &request) == 0;
  close(s);
  return up;
}

bool enter() {
  if (std::getenv("LACQUER_VM")) return bring_loopback_up();  // nobody else is there
  if ((unshare(CLONE_NEWNET) == 0 || unshare(CLONE_NEWUSER | CLONE_NEWNET) == 0) && bring_loopback_up()) return true;
  const int lock = open("/tmp/lacquer-gige-vision-test.lock", O_CREAT | O_RDWR | O_CLOEXEC, 0666);
  if (lock >= 0) flock(lock, LOCK_EX);  // until the process ends
  return false;
}

}  // namespace

void enter_private_loopback() { [[maybe_unused]] static const bool entered = enter(); }

}  // namespace lacquer::test
