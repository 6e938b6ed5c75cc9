#pragma once

namespace lacquer::acquire {

/// Seconds since a capture began, by the steady clock. Internal to libacquire.
class CaptureClock {
 public:
  /// `elapsed_s`: what has passed already.
  explicit CaptureClock(double elapsed_s = 0);
  double now() const;

 private:
  double start_;  ///< when the capture began, by the steady clock
};

/// Wall-clock time, seconds since 1970-01-01 UTC: the only clock that goes on while no process runs.
double unix_time();

/// Time since a capture that is resumed began. The wall clock may have been set back meanwhile; no frame was taken after `last_frame_s`,
/// and none is taken before it.
double elapsed_since(double begun_unix_s, double now_unix_s, double last_frame_s);

}  // namespace lacquer::acquire
