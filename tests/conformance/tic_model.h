#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "libacquire/clock.h"
#include "libacquire/tic/control_transfers.h"

namespace lacquer::test {

/// A Tic with motor, supply and limit switches, as Pololu's user's guide describes it (sections 5.4, 7, 8, 12): states and errors, safe
/// start, command timeout, homing, position uncertain, speed and acceleration limits. Requests that it does not know are stalled.
/// Used in process and behind USB/IP; safe to use from several threads.
class TicModel {
 public:
  explicit TicModel(acquire::Clock& clock);

  /// One vendor control transfer. nullopt: stalled. `length`: bytes asked for (IN).
  std::optional<std::vector<std::uint8_t>> control(std::uint8_t request_type, std::uint8_t request, std::uint16_t value, std::uint16_t index,
                                                   std::uint16_t length);

  // What an experimenter sees and does.
  double physical_position();             ///< microsteps the rotor has really turned
  bool energised();
  bool moved_while_uncertain() const { return moved_while_uncertain_; }
  void set_supply(double volts);
  void set_driver_error(bool on);
  void set_kill_switch(bool on);
  void set_missing_limit_switch();         ///< homing runs on for ever
  void set_limit_switches(double reverse_at, double forward_at);
  void set_jammed(bool on);                ///< steps are not made: the position never arrives
  void power_cycle();                      ///< the controller forgets its position
  void set_setting(std::uint8_t offset, std::uint8_t value);
  void set_highest_step_mode(std::uint8_t mode) { highest_step_mode_ = mode; }
  void set_highest_current_limit(std::uint8_t code) { highest_current_limit_ = code; }
  std::uint8_t current_limit() const { return current_limit_; }
  /// "e0 v=fed4 i=ffff" for every OUT transfer, in order.
  std::vector<std::string> out_log();
  double highest_speed() const { return highest_speed_; }                ///< microsteps/s ever run
  double highest_acceleration() const { return highest_acceleration_; }  ///< microsteps/s^2 ever used

 private:
  void advance();
  void step(double seconds);
  std::uint16_t errors() const;
  std::uint8_t state() const;
  bool command(std::uint8_t request, std::uint16_t value, std::uint16_t index);
  std::vector<std::uint8_t> variables();

  enum class Plan { off, position, velocity, home_towards, home_away };

  std::mutex mutex_;
  acquire::Clock& clock_;
  double time_ = 0, last_command_ = 0, energised_since_ = 0;
  double position_ = 0, velocity_ = 0;     // microsteps, microsteps/s; the rotor
  double offset_ = 0;                      // rotor minus the controller's count
  Plan plan_ = Plan::off;
  std::int32_t target_position_ = 0, target_velocity_ = 0;
  std::uint32_t max_speed_ = 2000000, starting_speed_ = 0, max_acceleration_ = 40000, max_deceleration_ = 0;
  bool energise_wanted_ = true, uncertain_ = true, safe_start_ = true, timed_out_ = false;
  bool driver_error_ = false, kill_switch_ = false, jammed_ = false, home_forward_ = false, no_switch_ = false;
  double supply_v_ = 12, reverse_limit_ = -1e9, forward_limit_ = 1e9;
  std::uint8_t step_mode_ = 0, highest_step_mode_ = 5, current_limit_ = 6, highest_current_limit_ = 124;
  std::uint32_t errors_occurred_ = 0;
  std::vector<std::uint8_t> settings_;
  std::vector<std::string> log_;
  double highest_speed_ = 0, highest_acceleration_ = 0;
  bool moved_while_uncertain_ = false;
};

/// The model as a driver sees it, with faults of the cable.
class ModelTransfers final : public acquire::ControlTransfers {
 public:
  struct Faults {
    int unplug_at = -1, stall_at = -1, time_out_at = -1;  ///< number of the transfer, from 0; unplugged: that and all later ones
    int n_transfers = 0;
    bool unplugged = false;
  };
  ModelTransfers(std::shared_ptr<TicModel> model, std::shared_ptr<Faults> faults) : model_(std::move(model)), faults_(std::move(faults)) {}
  void control_out(std::uint8_t request, std::uint16_t value, std::uint16_t index) override;
  std::vector<std::uint8_t> control_in(std::uint8_t request, std::uint16_t value, std::uint16_t index, std::uint16_t length) override;
  std::string product() const override { return "T825"; }
  std::string name() const override { return "Tic T825 00123456"; }

 private:
  void fault(std::uint8_t request);
  std::shared_ptr<TicModel> model_;
  std::shared_ptr<Faults> faults_;
};

}  // namespace lacquer::test
