#pragma once

namespace lacquer::acquire {

/// Time as a device driver sees it: the real one, or one that a test turns by hand.
class Clock {
 public:
  virtual ~Clock() = default;
  virtual double now() = 0;             ///< seconds since some fixed moment, never goes back
  virtual void sleep(double seconds) = 0;
  /// std::chrono::steady_clock and std::this_thread::sleep_for.
  static Clock& steady();
};

}  // namespace lacquer::acquire
