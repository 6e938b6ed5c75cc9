#include "libacquire/tic/tic_turntable.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <utility>

#include "libacquire/tic/tic_current.h"
#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

constexpr double tau = 6.28318530717958647692;
constexpr double degrees = 360 / tau;
constexpr double poll_s = 0.01;            ///< far below the command timeout, which every poll resets
constexpr double speed_unit = 1e4;         ///< speeds are in microsteps per 10 000 s
constexpr double acceleration_unit = 1e2;  ///< accelerations in microsteps per second per 100 s
constexpr double max_speed_units = 5e8;    ///< 50 kHz, the most a Tic does
constexpr double margin_s = 2;             ///< allowed beyond the computed duration of a move, on top of its half

/// Code of the step mode; the controller refuses by keeping the old one, which is found on reading back.
std::uint8_t step_mode_of(int microsteps, const std::string& name) {
  switch (microsteps) {
    case 1: return 0;
    case 2: return 1;
    case 4: return 2;
    case 8: return 3;
    case 16: return 4;
    case 32: return 5;
    case 64: return 7;
    case 128: return 8;
    case 256: return 9;
    default:
      throw Error(ErrorCode::usage, fmt::format("{}: devices.turntable.microsteps: expected 1, 2, 4, 8, 16, 32, 64, 128 or 256, got {}", name, microsteps));
  }
}

}  // namespace

TicTurntable::TicTurntable(std::unique_ptr<ControlTransfers> transfers, const TicSettings& settings, Clock& clock)
    : tic_(std::move(transfers)), settings_(settings), clock_(clock) {
  steps_per_radian_ = settings_.full_steps_per_turn * static_cast<double>(settings_.microsteps) * settings_.gear_ratio / tau;
  for (const double angle : {settings_.min_angle, settings_.max_angle})
    if (!(std::abs(angle - settings_.home_angle) + settings_.backlash < 2e9 / steps_per_radian_))
      throw Error(ErrorCode::usage, fmt::format("{}: devices.turntable: an angle of {:g} deg is more than 2e9 microsteps away", tic_.name(), angle * degrees));
  check_controller_settings();
  set_up_motion();
  start_motor();
  const TicStatus status = tic_.status_and_clear_errors_occurred();
  zero_known_ = !status.position_uncertain;
  if (!zero_known_ && settings_.home == TicSettings::Home::here) {
    tic_.halt_and_set_position(0);
    zero_known_ = true;
  }
}

TicTurntable::~TicTurntable() { hold(); }

/// What is set in the controller with Pololu's program decides whether it obeys and whether it holds while nothing is sent.
void TicTurntable::check_controller_settings() {
  constexpr std::uint8_t control_mode = 0x01, soft_error_response = 0x53, current_during_error = 0x31;
  if (const int mode = tic_.setting(control_mode); mode != 0)
    throw Error(ErrorCode::device, fmt::format("{}: control mode {}: expected \"Serial / I2C / USB\"; set it with Pololu's Tic Control Center", tic_.name(), mode));
  if (const int response = tic_.setting(soft_error_response); response != 2)
    throw Error(ErrorCode::device, fmt::format("{}: soft error response {}: expected \"Decelerate to hold\", or the position is lost during long exposures; "
                                               "set it with Pololu's Tic Control Center", tic_.name(), response));
  if (const int current = tic_.setting(current_during_error); current != 0xFF)
    throw Error(ErrorCode::device, fmt::format("{}: \"Use different current limit during soft error\" is on; the motor would not hold during long exposures; "
                                               "switch it off with Pololu's Tic Control Center", tic_.name()));
}

void TicTurntable::set_up_current() {
  if (!settings_.current_limit_a) return;
  const auto code = tic_current_code(tic_.product(), *settings_.current_limit_a);
  if (!code)
    throw Error(ErrorCode::usage, fmt::format("{}: devices.turntable.current_limit_ma: this controller has no current of {:g} mA or less but 0", tic_.name(),
                                              *settings_.current_limit_a * 1e3));
  tic_.set_current_limit(*code);
  if (const int actual = tic_.status().current_limit_code; actual != *code)
    throw Error(ErrorCode::device, fmt::format("{}: devices.turntable.current_limit_ma: asked for code {} ({:g} mA), read back code {}", tic_.name(), *code,
                                               *tic_current(tic_.product(), *code) * 1e3, actual));
}

void TicTurntable::set_up_motion() {
  tic_.clear_driver_error();
  set_up_current();
  const double speed = settings_.max_speed * steps_per_radian_ * speed_unit;
  if (!(speed >= 1 && speed <= max_speed_units))
    throw Error(ErrorCode::usage, fmt::format("{}: devices.turntable.max_speed_deg_per_s: {:g} microsteps per second; the controller does 1e-4 to 50000",
                                              tic_.name(), speed / speed_unit));
  const double acceleration = settings_.max_acceleration * steps_per_radian_ * acceleration_unit;
  if (!(acceleration >= 100 && acceleration <= 0x7FFFFFFF))
    throw Error(ErrorCode::usage, fmt::format("{}: devices.turntable.max_acceleration_deg_per_s2: {:g} microsteps per second squared; the controller does 1 to 2.1e7",
                                              tic_.name(), acceleration / acceleration_unit));
  const std::uint8_t mode = step_mode_of(settings_.microsteps, tic_.name());
  if (tic_.status().step_mode != mode) tic_.set_step_mode(mode);
  if (const int actual = tic_.status().step_mode; actual != mode)
    throw Error(ErrorCode::usage, fmt::format("{}: devices.turntable.microsteps: this controller does not do 1/{} steps (mode read back as {})", tic_.name(),
                                              settings_.microsteps, actual));
  tic_.set_starting_speed(0);
  tic_.set_max_speed(static_cast<std::int32_t>(std::llround(speed)));
  tic_.set_max_acceleration(static_cast<std::int32_t>(std::llround(acceleration)));
  tic_.set_max_deceleration(static_cast<std::int32_t>(std::llround(acceleration)));
}

void TicTurntable::start_motor() {
  // A target left over from another program must not start to move when the motor gets current: the speed asked for is zero.
  tic_.set_target_velocity(0);
  tic_.energise();
  tic_.exit_safe_start();
  const double began = clock_.now();
  while (true) {
    const TicStatus status = tic_.status();
    if (status.state == TicStatus::normal && status.errors == 0) return;
    const double waited = clock_.now() - began;
    // An error may take some milliseconds to clear; coils take longer to get their current.
    if (status.state != TicStatus::starting_up && waited > 0.5)
      lose_position(ErrorCode::device, fmt::format("cannot be switched on: {}; supply {:.1f} V",
                                                   status.errors ? tic_error_text(status.errors) : fmt::format("operation state {}", status.state), status.supply_v));
    if (waited > 2) lose_position(ErrorCode::timeout, "did not start within 2 s");
    clock_.sleep(poll_s);
    tic_.reset_command_timeout();
  }
}

double TicTurntable::do_move_to(double angle) {
  if (lost_) throw Error(ErrorCode::device, tic_.name() + ": the position was lost; home the table before going on");
  if (!zero_known_) do_home();
  TicStatus status = tic_.status();
  if (status.position_uncertain || status.errors & tic_error::lose_position)
    lose_position(ErrorCode::device, "the position was lost since the last move" + (status.errors ? ": " + tic_error_text(status.errors) : std::string()) +
                                         " (was the controller without power?)");
  if (status.state != TicStatus::normal) start_motor();  // a command timeout between two moves is ordinary

  const std::int32_t target = steps_of(angle);
  const auto backlash = static_cast<std::int32_t>(std::ceil(settings_.backlash * steps_per_radian_));
  const std::int64_t way = static_cast<std::int64_t>(target) - tic_.status().position;
  if (!(approached_forward_ && way >= 0) && way < backlash) travel_to(target - backlash);
  travel_to(target);
  approached_forward_ = backlash > 0 || way >= 0;
  clock_.sleep(settings_.settle_s);
  status = tic_.status();
  if (status.position_uncertain || status.position != target)
    lose_position(ErrorCode::device, fmt::format("slipped off the target while settling, from microstep {} to {}", target, status.position));
  tic_.set_target_velocity(0);  // holds here even if a soft error passes meanwhile
  return angle_of(status.position);
}

double TicTurntable::seconds_for(double microsteps) const {
  const double way = std::abs(microsteps) / steps_per_radian_;
  return way / settings_.max_speed + settings_.max_speed / settings_.max_acceleration;
}

void TicTurntable::travel_to(std::int32_t target) {
  const TicStatus start = tic_.status();
  if (start.position == target && start.velocity == 0) return;
  const double way = static_cast<double>(target) - start.position;
  const double deadline = clock_.now() + 1.5 * seconds_for(way) + margin_s;
  tic_.exit_safe_start();
  tic_.set_target_position(target);
  while (true) {
    const TicStatus status = tic_.status();
    check_while_moving(status, target);
    if (status.position == target && status.velocity == 0) return;
    if (clock_.now() > deadline)
      lose_position(ErrorCode::timeout, fmt::format("did not reach {:g} deg within {:.1f} s (microstep {} of {})", angle_of(target) * degrees,
                                                    1.5 * seconds_for(way) + margin_s, status.position, target));
    clock_.sleep(poll_s);
    tic_.reset_command_timeout();
  }
}

void TicTurntable::check_while_moving(const TicStatus& status, std::int32_t target) {
  if (status.errors) lose_position(ErrorCode::device, "stopped while moving: " + tic_error_text(status.errors));
  if (status.position_uncertain) lose_position(ErrorCode::device, "stopped abruptly while moving; steps may be lost");
  const bool forward = target > status.position;
  if (status.position != target && (forward ? status.forward_limit : status.reverse_limit))
    lose_position(ErrorCode::device, fmt::format("ran into the {} limit switch at microstep {} on the way to {:g} deg", forward ? "forward" : "reverse",
                                                 status.position, angle_of(target) * degrees));
}

void TicTurntable::do_home() {
  if (tic_.status().state != TicStatus::normal) {
    tic_.clear_driver_error();
    start_motor();
  }
  approached_forward_ = false;
  if (settings_.home == TicSettings::Home::here) {
    tic_.halt_and_set_position(0);
    zero_known_ = true;
    lost_ = false;
    return;
  }
  const bool forward = settings_.home == TicSettings::Home::forward;
  const double deadline = clock_.now() + settings_.home_timeout_s;
  tic_.exit_safe_start();
  tic_.go_home(forward);
  TicStatus status = tic_.status();
  while (status.homing) {
    if (status.errors) lose_position(ErrorCode::device, "stopped while homing: " + tic_error_text(status.errors));
    if (clock_.now() > deadline)
      lose_position(ErrorCode::timeout, fmt::format("found no {} limit switch within {:g} s (devices.turntable.home_timeout_s); check its wiring",
                                                    forward ? "forward" : "reverse", settings_.home_timeout_s));
    clock_.sleep(poll_s);
    tic_.reset_command_timeout();
    status = tic_.status();
  }
  if (status.errors || status.position_uncertain)
    lose_position(ErrorCode::device, fmt::format("homing ended without a position{}; is a {} limit switch set up in the controller?",
                                                 status.errors ? ": " + tic_error_text(status.errors) : std::string(), forward ? "forward" : "reverse"));
  zero_known_ = true;
  lost_ = false;
}

void TicTurntable::lose_position(ErrorCode code, const std::string& why) {
  zero_known_ = false;
  lost_ = true;
  approached_forward_ = false;
  std::string state = "the motor is switched off";
  try {
    tic_.de_energise();
  } catch (const Error& e) {
    state = fmt::format("the motor could not be switched off ({})", e.what());
  }
  throw Error(code, fmt::format("{}: {}; {}, home the table before going on", tic_.name(), why, state));
}

void TicTurntable::hold() noexcept {
  try {
    TicStatus status = tic_.status();
    if (!status.energised) return;
    tic_.set_target_velocity(0);  // brakes with the set deceleration, so no step is lost
    const double deadline = clock_.now() + 1.5 * settings_.max_speed / settings_.max_acceleration + margin_s;
    while (tic_.status().velocity != 0 && clock_.now() < deadline) {
      clock_.sleep(poll_s);
      tic_.reset_command_timeout();
    }
  } catch (...) {  // gone: the controller stops by itself after its command timeout
  }
}

std::int32_t TicTurntable::steps_of(double angle) const {
  const double steps = (angle - settings_.home_angle) * steps_per_radian_ * (settings_.reversed ? -1 : 1);
  return static_cast<std::int32_t>(std::llround(steps));
}

double TicTurntable::angle_of(std::int32_t steps) const {
  return settings_.home_angle + steps / steps_per_radian_ * (settings_.reversed ? -1 : 1);
}

}  // namespace lacquer::acquire
