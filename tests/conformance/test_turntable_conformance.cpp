#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "conformance/expect_error.h"
#include "conformance/peers.h"

namespace lacquer::test {
namespace {

constexpr double degree = std::numbers::pi / 180;

class TurntableConformance : public testing::TestWithParam<PeerMaker<TurntablePeer>> {
 protected:
  std::unique_ptr<TurntablePeer> peer = GetParam().make();

  void expect_at(double angle) {
    if (const auto physical = peer->physical_angle()) {
      EXPECT_NEAR(*physical, angle, 0.51 * peer->resolution());
    }
  }
};

TEST_P(TurntableConformance, StandsWhereItWasSentAndReadsItBack) {
  const auto table = peer->open();
  for (const double angle : {0.0, 10 * degree, -5 * degree, 30 * degree, 29.9 * degree, 0.0}) {
    EXPECT_NEAR(table->move_to(angle), angle, 0.51 * peer->resolution());  // half a step of the motor
    expect_at(angle);
  }
}

TEST_P(TurntableConformance, MovingToWhereItStandsChangesNothing) {
  const auto table = peer->open();
  const double first = table->move_to(7 * degree);
  EXPECT_EQ(table->move_to(7 * degree), first);
  expect_at(7 * degree);
}

TEST_P(TurntableConformance, RefusesAnglesBeyondItsLimitsAndStaysWhereItIs) {
  const auto table = peer->open();
  table->move_to(3 * degree);
  const auto limits = table->limits();
  expect_error(ErrorCode::usage, "the table turns from", [&] { table->move_to(limits.max_angle + 1); });
  expect_error(ErrorCode::usage, "the table turns from", [&] { table->move_to(limits.min_angle - 1); });
  expect_error(ErrorCode::usage, "finite", [&] { table->move_to(std::nan("")); });
  expect_at(3 * degree);
}

TEST_P(TurntableConformance, KeepsItsZeroWhenReopened) {
  peer->open()->move_to(20 * degree);
  const auto again = peer->open();
  again->move_to(25 * degree);
  expect_at(25 * degree);
}

TEST_P(TurntableConformance, HoldsTheMotorWhenClosed) {
  peer->open()->move_to(5 * degree);
  const auto energised = peer->energised();
  if (!energised) GTEST_SKIP() << "no motor current to be seen";
  EXPECT_TRUE(*energised);
  expect_at(5 * degree);
}

TEST_P(TurntableConformance, HoldMayBeCalledAtAnyTime) {
  const auto table = peer->open();
  table->hold();
  table->move_to(5 * degree);
  table->hold();
  table->hold();
  table->move_to(6 * degree);
  expect_at(6 * degree);
}

TEST_P(TurntableConformance, UnpluggedIsAnErrorAndPluggedInWorksAgain) {
  auto table = peer->open();
  table->move_to(5 * degree);
  if (!peer->unplug()) GTEST_SKIP() << "no plug to pull";
  expect_error(ErrorCode::device, "unplugged", [&] { table->move_to(6 * degree); });
  table->hold();
  table.reset();
  ASSERT_TRUE(peer->plug_in());
  table = peer->open();
  table->move_to(1 * degree);
}

TEST_P(TurntableConformance, NeverArrivingIsATimeoutThatSwitchesTheMotorOff) {
  const auto table = peer->open();
  table->move_to(1 * degree);
  if (!peer->jam()) GTEST_SKIP() << "cannot be jammed";
  expect_error(ErrorCode::timeout, "did not reach", [&] { table->move_to(3 * degree); });
  EXPECT_FALSE(peer->energised().value_or(false));
  expect_error(ErrorCode::device, "home the table", [&] { table->move_to(2 * degree); });
}

INSTANTIATE_TEST_SUITE_P(Devices, TurntableConformance, testing::ValuesIn(turntable_peers()), [](const auto& info) { return info.param.name; });
GTEST_ALLOW_UNINSTANTIATED_PARAMETERIZED_TEST(TurntableConformance);

}  // namespace
}  // namespace lacquer::test
