#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "conformance/expect_error.h"
#include "conformance/tic_model.h"
#include "conformance/turned_clock.h"
#include "libacquire/tic/tic_current.h"
#include "libacquire/tic/tic_turntable.h"

namespace lacquer::test {
namespace {

using acquire::TicSettings;
using acquire::TicTurntable;

constexpr double degree = std::numbers::pi / 180;
constexpr double steps_per_turn = 1600;  // 200 full steps of 8

class Tic : public testing::Test {
 protected:
  std::unique_ptr<ModelTransfers> cable() { return std::make_unique<ModelTransfers>(model, faults); }
  std::unique_ptr<TicTurntable> open() { return std::make_unique<TicTurntable>(cable(), settings, clock); }

  /// The error names the Tic and what happened, the motor has no current, and nothing moves before home().
  template <typename Call>
  void expect_lost(TicTurntable& table, ErrorCode code, const std::string& part, const Call& call) {
    expect_error(code, part, call);
    EXPECT_FALSE(model->energised());
    const double position = model->physical_position();
    expect_error(ErrorCode::device, "Tic T825 00123456: the position was lost; home", [&] { table.move_to(0.5); });
    EXPECT_EQ(model->physical_position(), position);
    EXPECT_FALSE(model->moved_while_uncertain());
  }

  /// Something happens `after` seconds into the next sleeps: a clock that does it.
  class Surprise final : public acquire::Clock {
   public:
    Surprise(TurnedClock& clock, double after, std::function<void()> act) : clock_(clock), at_(clock.now() + after), act_(std::move(act)) {}
    double now() override { return clock_.now(); }
    void sleep(double s) override {
      clock_.sleep(s);
      if (act_ && clock_.now() >= at_) std::exchange(act_, nullptr)();
    }

   private:
    TurnedClock& clock_;
    double at_;
    std::function<void()> act_;
  };

  template <typename Act>
  void expect_lost_while_moving(const std::string& part, const Act& act) {
    Surprise surprise(clock, 1.0, act);  // opening takes some 0.03 s, the move 180 / 28.6 = 6 s
    TicTurntable table(cable(), settings, surprise);
    expect_lost(table, ErrorCode::device, part, [&] { table.move_to(180 * degree); });
  }

  TurnedClock clock;
  TicSettings settings;
  std::shared_ptr<TicModel> model = std::make_shared<TicModel>(clock);
  std::shared_ptr<ModelTransfers::Faults> faults = std::make_shared<ModelTransfers::Faults>();
};

/// The wire log of Pololu's own ticcmd for --resume --position -300, --halt-and-hold, --halt-and-set-position 0, --home fwd and
/// --deenergize, recorded against an independent emulator of the controller.
TEST_F(Tic, CommandsAreThoseThatPololusOwnProgramSends) {
  acquire::TicController tic(cable());
  tic.set_target_position(-300);
  tic.energise();
  tic.exit_safe_start();
  tic.halt_and_hold();
  tic.halt_and_set_position(0);
  tic.go_home(true);
  tic.de_energise();
  EXPECT_EQ(model->out_log(), (std::vector<std::string>{"e0 v=fed4 i=ffff", "85", "83", "89", "ec v=0000 i=0000", "97 v=0001", "86"}));
}

TEST_F(Tic, OpeningMovesNothingAndALeftOverTargetIsForgotten) {
  // Another program left a target; the motor is off.
  acquire::TicController(cable()).set_target_position(5000);
  acquire::TicController(cable()).de_energise();
  const auto table = open();
  clock.sleep(0.5);
  table->hold();
  EXPECT_EQ(model->physical_position(), 0);
  EXPECT_TRUE(model->energised());
}

TEST_F(Tic, SpeedAndAccelerationStayBelowTheirLimits) {
  settings.max_speed = 0.3;
  settings.max_acceleration = 0.2;
  open()->move_to(90 * degree);
  const double unit = steps_per_turn / (2 * std::numbers::pi);
  EXPECT_NEAR(model->highest_speed(), 0.3 * unit, 0.01 * unit);  // it is reached: 90 deg are long enough
  EXPECT_LE(model->highest_acceleration(), 0.2 * unit * (1 + 1e-3));
}

TEST_F(Tic, BacklashIsTakenUpFromOneSide) {
  settings.backlash = 2 * degree;
  const auto table = open();
  const auto back = static_cast<int>(std::ceil(2.0 / 360 * steps_per_turn));
  const auto targets_of = [&](double angle) {
    const std::size_t before = model->out_log().size();
    table->move_to(angle);
    std::vector<int> targets;
    const auto log = model->out_log();
    for (std::size_t i = before; i < log.size(); ++i)
      if (log[i].starts_with("e0")) targets.push_back(static_cast<std::int16_t>(std::stoi(log[i].substr(5, 4), nullptr, 16)));
    return targets;
  };
  EXPECT_EQ(targets_of(90 * degree), std::vector<int>{400});                 // a long way forward takes it up
  EXPECT_EQ(targets_of(90.225 * degree), std::vector<int>{401});             // and further forward it stays taken up
  EXPECT_EQ(targets_of(45 * degree), (std::vector<int>{200 - back, 200}));   // backwards: beyond, then forward
  EXPECT_EQ(targets_of(45 * degree), std::vector<int>{});
}

TEST_F(Tic, FirstTargetAfterOpeningIsApproachedForwardWhateverCameBefore) {
  settings.backlash = 2 * degree;
  open()->move_to(0);
  std::vector<std::string> targets;
  for (const std::string& line : model->out_log())
    if (line.starts_with("e0")) targets.push_back(line);
  EXPECT_EQ(targets, (std::vector<std::string>{"e0 v=fff7 i=ffff", "e0 v=0000 i=0000"}));  // 2 deg: 8.9 microsteps, rounded up
}

TEST_F(Tic, LongMovesDoNotTimeOutAndPausesBetweenMovesDoNotLoseThePosition) {
  settings.max_speed = 0.05;  // 180 deg: a minute, against a command timeout of a second
  const auto table = open();
  table->move_to(180 * degree);
  clock.sleep(3600);  // an hour of exposures: the controller stops listening, but holds
  EXPECT_TRUE(model->energised());
  EXPECT_NEAR(table->move_to(181 * degree), 181 * degree, 0.51 * 2 * std::numbers::pi / steps_per_turn);
  EXPECT_NEAR(model->physical_position(), 181.0 / 360 * steps_per_turn, 0.51);
}

TEST_F(Tic, HoldBrakesGentlyAndKeepsThePosition) {
  Surprise interrupt(clock, 1.0, [] { throw Error(ErrorCode::interrupted, "Ctrl-C"); });
  TicTurntable table(cable(), settings, interrupt);
  expect_error(ErrorCode::interrupted, "Ctrl-C", [&] { table.move_to(180 * degree); });
  table.hold();
  const double stands = model->physical_position();
  EXPECT_GT(stands, 0);
  EXPECT_LT(stands, 400);
  clock.sleep(2);
  EXPECT_EQ(model->physical_position(), stands);
  EXPECT_TRUE(model->energised());
  EXPECT_NEAR(table.move_to(10 * degree), 10 * degree, 0.01);  // still knows where it is
}

TEST_F(Tic, HomesAtTheSwitchAndCountsFromIt) {
  settings.home = TicSettings::Home::reverse;
  settings.home_angle = -20 * degree;
  settings.min_angle = -20 * degree;
  model->set_limit_switches(-500, 3000);  // the switch is 500 microsteps behind where it stands
  const auto table = open();
  EXPECT_EQ(model->physical_position(), 0);  // opening alone does not move
  table->move_to(-20 * degree);
  EXPECT_NEAR(model->physical_position(), -500, 2);  // the model's own resolution of 1 ms at a quarter of the speed
  table->move_to(70 * degree);
  EXPECT_NEAR(model->physical_position(), -500 + 400, 2);
}

TEST_F(Tic, DoesNotHomeAgainWhileTheControllerKnowsItsPosition) {
  settings.home = TicSettings::Home::reverse;
  model->set_limit_switches(-500, 3000);
  open()->move_to(10 * degree);
  const auto homings = [&] {
    const auto log = model->out_log();
    return std::count(log.begin(), log.end(), "97 v=0000");
  };
  ASSERT_EQ(homings(), 1);
  open()->move_to(11 * degree);
  EXPECT_EQ(homings(), 1);
  open()->home();
  EXPECT_EQ(homings(), 2);
}

TEST_F(Tic, MissingHomeSwitchIsATimeout) {
  settings.home = TicSettings::Home::forward;
  settings.home_timeout_s = 10;
  model->set_missing_limit_switch();
  const auto table = open();
  expect_lost(*table, ErrorCode::timeout, "found no forward limit switch within 10 s", [&] { table->move_to(0); });
}

TEST_F(Tic, HomingEndsALoss) {
  settings.home = TicSettings::Home::reverse;
  model->set_limit_switches(-500, 3000);
  const auto table = open();
  table->move_to(10 * degree);
  model->set_driver_error(true);
  clock.sleep(0.1);
  expect_lost(*table, ErrorCode::device, "position was lost since the last move", [&] { table->move_to(20 * degree); });
  table->home();
  table->move_to(45 * degree);
  EXPECT_NEAR(model->physical_position(), -500 + 200, 2);
}

TEST_F(Tic, LowSupplyWhileMoving) {
  expect_lost_while_moving("low supply voltage", [&] { model->set_supply(3); });
}
TEST_F(Tic, DriverErrorWhileMoving) {
  expect_lost_while_moving("motor driver error", [&] { model->set_driver_error(true); });
}
TEST_F(Tic, KillSwitchWhileMoving) {
  expect_lost_while_moving("kill switch", [&] { model->set_kill_switch(true); });
}
TEST_F(Tic, SwitchedOffByAnotherProgramWhileMoving) {
  expect_lost_while_moving("switched off", [&] { acquire::TicController(cable()).de_energise(); });
}
TEST_F(Tic, PowerLostForAMomentWhileMoving) {
  expect_lost_while_moving("", [&] { model->power_cycle(); });
}
TEST_F(Tic, SafeStartViolationWhileMoving) {
  expect_lost_while_moving("safe start violation", [&] { cable()->control_out(0x8F, 0, 0); });
}
TEST_F(Tic, HaltedByAnotherProgramWhileMoving) {
  expect_lost_while_moving("stopped abruptly", [&] { acquire::TicController(cable()).halt_and_hold(); });
}
TEST_F(Tic, LimitSwitchOnTheWay) {
  model->set_limit_switches(-1e9, 300);
  const auto table = open();
  expect_lost(*table, ErrorCode::device, "stopped abruptly", [&] { table->move_to(180 * degree); });
}

TEST_F(Tic, ComputerSilentForTooLongWhileMoving) {
  // A suspended computer: one sleep of ten seconds. The controller has stopped the motor by itself.
  Surprise suspended(clock, 1.0, [&] { clock.sleep(10); });
  TicTurntable table(cable(), settings, suspended);
  // Resetting the timeout lets the controller go on to the target only if it was not in error; here it stands.
  expect_lost(table, ErrorCode::timeout, "did not reach", [&] { table.move_to(180 * degree); });
}

TEST_F(Tic, NoMotorSupplyIsSaidOnOpening) {
  model->set_supply(0.2);
  expect_error(ErrorCode::device, "low supply voltage (check the motor's power supply); supply 0.2 V", [&] { open(); });
}

TEST_F(Tic, ControllerSettingsThatWouldLoseStepsAreRefused) {
  model->set_setting(0x01, 2);
  expect_error(ErrorCode::device, "control mode 2: expected \"Serial", [&] { open(); });
  model->set_setting(0x01, 0);
  model->set_setting(0x53, 0);
  expect_error(ErrorCode::device, "soft error response 0", [&] { open(); });
  model->set_setting(0x53, 2);
  model->set_setting(0x31, 4);
  expect_error(ErrorCode::device, "different current limit", [&] { open(); });
}

TEST_F(Tic, StepModeThatTheControllerDoesNotHaveIsRefused) {
  settings.microsteps = 64;
  expect_error(ErrorCode::usage, "does not do 1/64 steps", [&] { open(); });
  settings.microsteps = 5;
  expect_error(ErrorCode::usage, "microsteps: expected 1, 2, 4", [&] { open(); });
}

// Values of the tables in the Tic user's guide.
TEST_F(Tic, CurrentLimitIsTheNearestBelowAndReadBack) {
  open();
  EXPECT_EQ(model->current_limit(), 6) << "nothing said: as it was set in the controller";
  settings.current_limit_a = 1.0;
  open();
  EXPECT_EQ(model->current_limit(), 31) << "992 mA";
  model->set_highest_current_limit(20);
  expect_error(ErrorCode::device, "current_limit_ma: asked for code 31 (992 mA), read back code 20", [&] { open(); });
  settings.current_limit_a = 0.01;
  expect_error(ErrorCode::usage, "has no current of 10 mA or less but 0", [&] { open(); });
  EXPECT_EQ(acquire::tic_current_code("T825", 2.2), 68) << "2176 mA; in steps of four codes up there";
  EXPECT_EQ(acquire::tic_current_code("T834", 9), 108) << "3456 mA are its most";
  EXPECT_EQ(acquire::tic_current_code("T249", 1.5), 36) << "1440 mA; 37 does not exist";
  EXPECT_EQ(acquire::tic_current_code("T500", 1.2), 10) << "1189 mA";
  EXPECT_NEAR(*acquire::tic_current("36v4", 56), 4.010, 5e-4);
  EXPECT_EQ(acquire::tic_current_code("T1000", 1), std::nullopt);
}

TEST_F(Tic, ImpossibleMotionIsRefused) {
  settings.max_speed = 300;  // 76000 microsteps per second
  expect_error(ErrorCode::usage, "max_speed_deg_per_s", [&] { open(); });
  settings.max_speed = 0.5;
  settings.max_acceleration = 1e-4;
  expect_error(ErrorCode::usage, "max_acceleration_deg_per_s2", [&] { open(); });
  settings.max_acceleration = 1;
  settings.max_angle = 1e8;
  expect_error(ErrorCode::usage, "2e9 microsteps", [&] { open(); });
}

/// Whatever transfer fails, and however: one clear error, never a hang, never a move with a lost zero; and where the cable is still
/// there the motor is without current if the position is lost, under current if it is not.
class TicFaults : public Tic, public testing::WithParamInterface<const char*> {};

TEST_P(TicFaults, AtEveryTransferEndInOneErrorAndARecovery) {
  settings.backlash = 1 * degree;
  int n_total = 0;
  {
    const auto table = open();
    table->move_to(12 * degree);
    n_total = faults->n_transfers;
  }
  ASSERT_GT(n_total, 50);
  int n_errors = 0;
  for (int k = 0; k < n_total; ++k) {
    model = std::make_shared<TicModel>(clock);
    faults = std::make_shared<ModelTransfers::Faults>();
    const std::string kind = GetParam();
    (kind == "unplug" ? faults->unplug_at : kind == "stall" ? faults->stall_at : faults->time_out_at) = k;
    std::unique_ptr<TicTurntable> table;
    try {
      table = open();
      table->move_to(12 * degree);
    } catch (const Error& e) {
      ++n_errors;
      EXPECT_TRUE(e.code() == ErrorCode::device || e.code() == ErrorCode::timeout) << e.what();
      EXPECT_NE(std::string(e.what()).find("Tic T825 00123456"), std::string::npos) << e.what();
      EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos);
    }
    table.reset();
    clock.sleep(5);
    const double stands = model->physical_position();
    clock.sleep(5);
    EXPECT_EQ(model->physical_position(), stands) << "still moving, transfer " << k;
    faults->unplugged = false;
    faults->unplug_at = faults->stall_at = faults->time_out_at = -1;
    const auto again = open();
    again->move_to(3 * degree);
    EXPECT_FALSE(model->moved_while_uncertain()) << k;
  }
  EXPECT_EQ(n_errors, n_total);
}

INSTANTIATE_TEST_SUITE_P(Cable, TicFaults, testing::Values("unplug", "stall", "timeout"), [](const auto& info) { return std::string(info.param); });

}  // namespace
}  // namespace lacquer::test
