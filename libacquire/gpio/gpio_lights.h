#pragma once

#include <memory>
#include <optional>

#include "libacquire/clock.h"
#include "libacquire/devices.h"
#include "libacquire/gpio/gpio_lines.h"

namespace lacquer::acquire {

/// LEDs on GPIO lines. The line of the light that is on stays requested until it is switched off; at no moment are two on. All are off
/// after construction, off(), a failed on() and destruction. After kill -9 the kernel releases the lines; a pull-down at the LED driver's
/// input makes that "off" on every board (rigs/README.md).
class GpioLights final : public LightSwitch {
 public:
  /// `settle_s`: on() returns that long after the light was switched on; at once if it was on already.
  GpioLights(std::unique_ptr<GpioLines> lines, double settle_s, Clock& clock = Clock::steady());
  ~GpioLights() override { off(); }
  void off() noexcept override;
  std::string description() const override;
  int n_lights() const override { return static_cast<int>(lines_->size()); }

 private:
  void do_on(int index) override;

  std::unique_ptr<GpioLines> lines_;
  double settle_s_;
  Clock& clock_;
  std::optional<std::size_t> lit_;
};

}  // namespace lacquer::acquire
