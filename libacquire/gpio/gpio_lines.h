#pragma once

#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "libacquire/device_settings.h"

namespace lacquer::acquire {

/// Requested output lines, one per light; logical values (true: the light is on, whatever the wiring).
class GpioLines {
 public:
  virtual ~GpioLines() = default;
  virtual std::size_t size() const = 0;
  /// Throws Error{device}.
  virtual void set(std::size_t line, bool on) = 0;
  /// Read back from the line itself. Throws Error{device}.
  virtual bool get(std::size_t line) = 0;
  virtual std::string name(std::size_t line) const = 0;  ///< "gpiochip0 line 17 (LED3)"
};

/// Requests every line as an output that is off, through libgpiod 1.6, and keeps the requests: a line may fall back the moment its request
/// ends. Destruction switches all off, then releases them. Throws Error{device}: no such chip or line, taken by another program,
/// not allowed.
std::unique_ptr<GpioLines> open_gpiod_lines(const std::vector<GpioLightSettings>& lights);

struct FoundGpioChip {
  std::string name;     ///< "gpiochip0"
  std::string label;    ///< of the driver
  unsigned n_lines = 0;
  std::vector<std::string> named_lines;  ///< "3 LED3"; lines without a name are left out
  std::string problem;  ///< why it cannot be opened; empty: it can
};

std::vector<FoundGpioChip> find_gpio_chips();

}  // namespace lacquer::acquire
