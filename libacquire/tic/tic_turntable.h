#pragma once

#include <cstdint>
#include <memory>

#include "libacquire/clock.h"
#include "libacquire/device_settings.h"
#include "libacquire/devices.h"
#include "libacquire/tic/tic_controller.h"
#include "libbrdf/error.h"

namespace lacquer::acquire {

/// A stepper turntable on a Pololu Tic. Steps are counted, not measured: the angle read back is the controller's count, which is true as
/// long as the motor is under current and not forced. Whenever that may not have been so (driver error, low supply, reset, stop by a limit
/// switch) the motor is switched off, the error says why, and nothing moves before home().
///
/// The controller stops the motor by itself when the computer is silent for its command timeout (1 s as delivered).
class TicTurntable final : public Turntable {
 public:
  /// Sets step mode, speed and acceleration, energises. Does not move. Throws Error {usage, device, timeout}.
  TicTurntable(std::unique_ptr<ControlTransfers> transfers, const TicSettings& settings, Clock& clock = Clock::steady());
  ~TicTurntable() override;
  void hold() noexcept override;
  std::string description() const override { return tic_.name(); }
  TurntableLimits limits() const override { return {settings_.min_angle, settings_.max_angle}; }

 private:
  double do_move_to(double angle) override;
  void do_home() override;

  void check_controller_settings();
  void set_up_motion();
  void set_up_current();
  void start_motor();
  void travel_to(std::int32_t target);
  void check_while_moving(const TicStatus& status, std::int32_t target);
  [[noreturn]] void lose_position(ErrorCode code, const std::string& why);
  double seconds_for(double microsteps) const;
  std::int32_t steps_of(double angle) const;
  double angle_of(std::int32_t steps) const;

  TicController tic_;
  TicSettings settings_;
  Clock& clock_;
  double steps_per_radian_ = 0;    ///< microsteps per radian of the table, > 0
  bool zero_known_ = false;        ///< the controller's count refers to the rig's angle 0
  bool lost_ = false;              ///< it did and does no longer; only home() helps
  bool approached_forward_ = false;  ///< the last motion took up the backlash in the forward sense
};

}  // namespace lacquer::acquire
