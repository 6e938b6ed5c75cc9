#include <gtest/gtest.h>

#include "conformance/expect_error.h"
#include "conformance/fake_gpio_lines.h"
#include "conformance/turned_clock.h"
#include "libacquire/gpio/gpio_lights.h"

namespace lacquer::test {
namespace {

class GpioLights : public testing::Test {
 protected:
  std::unique_ptr<acquire::GpioLights> open(double settle_s = 0.1) {
    return std::make_unique<acquire::GpioLights>(std::make_unique<FakeGpioLines>(wires), settle_s, clock);
  }
  std::vector<bool> dark{false, false, false};
  TurnedClock clock;
  std::shared_ptr<FakeWires> wires = std::make_shared<FakeWires>(3);
};

TEST_F(GpioLights, WaitUntilALightHasSettledButNotForOneThatIsOn) {
  const auto lights = open(0.25);
  lights->on(1);
  EXPECT_EQ(clock.now(), 0.25);
  lights->on(1);
  EXPECT_EQ(clock.now(), 0.25);
  lights->on(2);
  EXPECT_EQ(clock.now(), 0.5);
  lights->off();
  lights->on(2);
  EXPECT_EQ(clock.now(), 0.75);
}

TEST_F(GpioLights, AreSwitchedOffOnOpening) {
  wires->on = {true, false, true};
  const auto lights = open();
  EXPECT_EQ(wires->on, dark);
}

TEST_F(GpioLights, ShortedLineIsFoundAndAllGoDark) {
  wires->stuck_off[1] = true;
  const auto lights = open();
  expect_error(ErrorCode::device, "fake line 1: does not go on", [&] { lights->on(1); });
  EXPECT_EQ(wires->on, dark);
}

TEST_F(GpioLights, LightThatStaysOnIsFoundBeforeASecondOneGoesOn) {
  wires->stuck_on[2] = true;
  const auto lights = open();
  expect_error(ErrorCode::device, "fake line 2: is on although", [&] { lights->on(0); });
  EXPECT_EQ(wires->on, dark);
  EXPECT_FALSE(wires->two_were_on);
}

TEST_F(GpioLights, AnyFailingSwitchLeavesThemDark) {
  for (int k = 3; k < 12; ++k) {  // 0..2: opening
    wires = std::make_shared<FakeWires>(3);
    wires->fail_set_at = k;
    const auto lights = open();
    try {
      for (int i = 0; i < 3; ++i) lights->on(i);
    } catch (const Error&) {
      EXPECT_EQ(wires->on, dark) << "after failing switch " << k;
    }
    EXPECT_FALSE(wires->two_were_on);
  }
}

TEST_F(GpioLights, DeadLineDoesNotKeepTheOthersOn) {
  const auto lights = open();
  lights->on(2);
  wires->fail_set_at = wires->n_sets;  // the first of off()
  lights->off();
  EXPECT_EQ(wires->on, dark);
}

}  // namespace
}  // namespace lacquer::test
