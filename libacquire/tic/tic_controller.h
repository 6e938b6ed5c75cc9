#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "libacquire/tic/control_transfers.h"

namespace lacquer::acquire {

/// The state of a Tic, variables 0x00..0x49 read in one transfer (Pololu, Tic user's guide, section 7).
struct TicStatus {
  enum State : std::uint8_t { reset = 0, de_energised = 2, soft_error = 4, waiting_for_err_line = 6, starting_up = 8, normal = 10 };
  std::uint8_t state = reset;
  bool energised = false;
  bool position_uncertain = true;
  bool forward_limit = false, reverse_limit = false;
  bool homing = false;
  std::uint16_t errors = 0;           ///< bits of TicError that stop the motor now
  std::uint32_t errors_occurred = 0;  ///< since they were last cleared
  std::int32_t target = 0;            ///< microsteps, as are all positions
  std::int32_t position = 0;
  std::int32_t velocity = 0;          ///< microsteps per 10 000 s
  double supply_v = 0;
  std::uint8_t step_mode = 0;
  std::uint8_t current_limit_code = 0;  ///< tic_current.h
};

namespace tic_error {
constexpr unsigned intentionally_de_energised = 1u << 0, motor_driver = 1u << 1, low_supply = 1u << 2, kill_switch = 1u << 3,
                   required_input = 1u << 4, serial = 1u << 5, command_timeout = 1u << 6, safe_start = 1u << 7, err_line = 1u << 8;
/// After these the coils were without current or the driver chip was reset: the position is worth nothing.
constexpr unsigned lose_position = motor_driver | low_supply;
}  // namespace tic_error

/// Names of the error bits with what to do, "low supply voltage (check the motor's supply), ..."; empty: none.
std::string tic_error_text(unsigned errors);

/// The commands of a Tic, one member each, and nothing else: no state, no waiting. Every call throws what the transfers throw.
class TicController {
 public:
  explicit TicController(std::unique_ptr<ControlTransfers> transfers) : usb_(std::move(transfers)) {}

  void energise() { quick(0x85); }
  void de_energise() { quick(0x86); }
  void exit_safe_start() { quick(0x83); }
  void halt_and_hold() { quick(0x89); }           ///< abrupt; the position becomes uncertain
  void reset_command_timeout() { quick(0x8C); }
  void clear_driver_error() { quick(0x8A); }
  void set_target_position(std::int32_t microsteps) { word(0xE0, microsteps); }
  void set_target_velocity(std::int32_t microsteps_per_10000_s) { word(0xE3, microsteps_per_10000_s); }
  void halt_and_set_position(std::int32_t microsteps) { word(0xEC, microsteps); }
  void set_max_speed(std::int32_t microsteps_per_10000_s) { word(0xE6, microsteps_per_10000_s); }
  void set_starting_speed(std::int32_t microsteps_per_10000_s) { word(0xE5, microsteps_per_10000_s); }
  void set_max_acceleration(std::int32_t microsteps_per_100_s2) { word(0xEA, microsteps_per_100_s2); }
  void set_max_deceleration(std::int32_t microsteps_per_100_s2) { word(0xE9, microsteps_per_100_s2); }
  void set_step_mode(std::uint8_t mode) { usb_->control_out(0x94, mode, 0); }
  void set_current_limit(std::uint8_t code) { usb_->control_out(0x91, code, 0); }
  void go_home(bool forward) { usb_->control_out(0x97, forward ? 1 : 0, 0); }

  TicStatus status() const { return read_status(0xA1); }
  TicStatus status_and_clear_errors_occurred() const { return read_status(0xA2); }
  /// A byte of the settings that Pololu's Tic Control Center writes.
  std::uint8_t setting(std::uint8_t offset) const { return usb_->control_in(0xA8, 0, offset, 1).at(0); }
  std::string product() const { return usb_->product(); }
  std::string name() const { return usb_->name(); }

 private:
  void quick(std::uint8_t request) { usb_->control_out(request, 0, 0); }
  void word(std::uint8_t request, std::int32_t value) {
    const auto bits = static_cast<std::uint32_t>(value);
    usb_->control_out(request, static_cast<std::uint16_t>(bits & 0xFFFF), static_cast<std::uint16_t>(bits >> 16));
  }
  TicStatus read_status(std::uint8_t request) const;

  std::unique_ptr<ControlTransfers> usb_;
};

}  // namespace lacquer::acquire
