#include "libacquire/capture_clock.h"

#include <algorithm>
#include <chrono>

#include "libacquire/clock.h"

namespace lacquer::acquire {

CaptureClock::CaptureClock(double elapsed_s) : start_(Clock::steady().now() - elapsed_s) {}

double CaptureClock::now() const { return Clock::steady().now() - start_; }

double unix_time() { return std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count(); }

double elapsed_since(double begun_unix_s, double now_unix_s, double last_frame_s) {
  return std::max(now_unix_s - begun_unix_s, last_frame_s);
}

}  // namespace lacquer::acquire
