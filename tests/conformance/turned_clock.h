#pragma once

#include "libacquire/clock.h"

namespace lacquer::test {

/// A clock that moves when somebody sleeps on it: minutes of motion in microseconds, the same every time.
class TurnedClock final : public acquire::Clock {
 public:
  double now() override { return now_; }
  void sleep(double seconds) override {
    if (seconds > 0) now_ += seconds;
  }

 private:
  double now_ = 0;
};

}  // namespace lacquer::test
