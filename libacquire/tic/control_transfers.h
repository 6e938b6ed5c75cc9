#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace lacquer::acquire {

/// USB vendor control transfers to one opened device: all that a Tic needs of USB.
class ControlTransfers {
 public:
  virtual ~ControlTransfers() = default;
  /// bmRequestType 0x40 without data. Throws Error: device (gone, refused) or timeout.
  virtual void control_out(std::uint8_t request, std::uint16_t value, std::uint16_t index) = 0;
  /// bmRequestType 0xC0; exactly `length` bytes, else Error.
  virtual std::vector<std::uint8_t> control_in(std::uint8_t request, std::uint16_t value, std::uint16_t index, std::uint16_t length) = 0;
  virtual std::string product() const = 0;  ///< "T825"
  virtual std::string name() const = 0;  ///< "Tic T825 00123456", begins every message
};

}  // namespace lacquer::acquire
