#include "libacquire/tic/tic_controller.h"

#include <array>
#include <utility>

namespace lacquer::acquire {

namespace {

constexpr std::uint16_t status_bytes = 0x4C;

}  // namespace

TicStatus TicController::read_status(std::uint8_t request) const {
  const std::vector<std::uint8_t> bytes = usb_->control_in(request, 0, 0, status_bytes);
  const auto at = [&](std::size_t offset, int n) {
    std::uint32_t value = 0;
    for (int i = 0; i < n; ++i) value |= static_cast<std::uint32_t>(bytes.at(offset + static_cast<std::size_t>(i))) << (8 * i);
    return value;
  };
  TicStatus s;
  s.state = bytes.at(0);
  s.energised = bytes.at(1) & 1;
  s.position_uncertain = bytes.at(1) & 2;
  s.forward_limit = bytes.at(1) & 4;
  s.reverse_limit = bytes.at(1) & 8;
  s.homing = bytes.at(1) & 16;
  s.errors = static_cast<std::uint16_t>(at(0x02, 2));
  s.errors_occurred = at(0x04, 4);
  s.target = static_cast<std::int32_t>(at(0x0A, 4));
  s.position = static_cast<std::int32_t>(at(0x22, 4));
  s.velocity = static_cast<std::int32_t>(at(0x26, 4));
  s.supply_v = at(0x33, 2) * 1e-3;
  s.step_mode = bytes.at(0x49);
  s.current_limit_code = bytes.at(0x4A);
  return s;
}

std::string tic_error_text(unsigned errors) {
  constexpr std::array<std::pair<unsigned, const char*>, 9> texts{{
      {tic_error::intentionally_de_energised, "the motor is switched off"},
      {tic_error::motor_driver, "motor driver error (over-temperature, over-current or a wiring fault of the motor)"},
      {tic_error::low_supply, "low supply voltage (check the motor's power supply)"},
      {tic_error::kill_switch, "the kill switch is active"},
      {tic_error::required_input, "a required input is invalid"},
      {tic_error::serial, "serial error (is something else talking to the controller?)"},
      {tic_error::command_timeout, "command timeout (the controller heard nothing for too long)"},
      {tic_error::safe_start, "safe start violation"},
      {tic_error::err_line, "the ERR line is high (another controller reports an error)"},
  }};
  std::string result;
  for (const auto& [bit, text] : texts)
    if (errors & bit) result += (result.empty() ? "" : ", ") + std::string(text);
  return result;
}

}  // namespace lacquer::acquire
