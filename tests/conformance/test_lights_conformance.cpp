#include <gtest/gtest.h>

#include <algorithm>

#include "conformance/expect_error.h"
#include "conformance/peers.h"

namespace lacquer::test {
namespace {

class LightsConformance : public testing::TestWithParam<PeerMaker<LightsPeer>> {
 protected:
  std::unique_ptr<LightsPeer> peer = GetParam().make();

  /// Only light `index` shines; -1: none.
  void expect_only(int index) {
    const auto shining = peer->shining();
    if (!shining) return;
    for (int i = 0; i < peer->n_lights(); ++i) EXPECT_EQ(shining->at(static_cast<std::size_t>(i)), i == index) << "light " << i;
  }
};

TEST_P(LightsConformance, ShinesOneAtATime) {
  const auto lights = peer->open();
  ASSERT_EQ(lights->n_lights(), peer->n_lights());
  expect_only(-1);
  for (int round = 0; round < 2; ++round)
    for (int i = 0; i < peer->n_lights(); ++i) {
      lights->on(i);
      expect_only(i);
    }
  lights->on(0);
  lights->on(0);
  expect_only(0);
  lights->off();
  expect_only(-1);
  EXPECT_FALSE(peer->two_shone());
}

TEST_P(LightsConformance, RefusesLightsThatAreNotThereAndKeepsTheOneThatIs) {
  const auto lights = peer->open();
  lights->on(0);
  expect_error(ErrorCode::usage, "light", [&] { lights->on(peer->n_lights()); });
  expect_error(ErrorCode::usage, "light", [&] { lights->on(-1); });
  expect_only(0);
}

TEST_P(LightsConformance, IsDarkWhenClosed) {
  peer->open()->on(peer->n_lights() - 1);
  if (!peer->shining()) GTEST_SKIP() << "not to be seen once it is closed";
  expect_only(-1);
}

TEST_P(LightsConformance, IsDarkWhenAnExceptionPasses) {
  try {
    acquire::Rig rig;
    rig.lights = peer->open();
    rig.lights->on(0);
    throw Error(ErrorCode::device, "the camera was unplugged");
  } catch (const Error&) {
  }
  if (!peer->shining()) GTEST_SKIP() << "not to be seen once it is closed";
  expect_only(-1);
}

TEST_P(LightsConformance, OpensAgain) {
  peer->open()->on(0);
  const auto again = peer->open();
  expect_only(-1);
  again->on(0);
  expect_only(0);
}

TEST_P(LightsConformance, UnpluggedIsAnErrorAndPluggedInWorksAgain) {
  auto lights = peer->open();
  lights->on(0);
  if (!peer->unplug()) GTEST_SKIP() << "no plug to pull";
  expect_error(ErrorCode::device, "", [&] { lights->on(peer->n_lights() - 1); });
  lights->off();
  lights.reset();
  ASSERT_TRUE(peer->plug_in());
  lights = peer->open();
  lights->on(0);
  expect_only(0);
}

INSTANTIATE_TEST_SUITE_P(Devices, LightsConformance, testing::ValuesIn(lights_peers()), [](const auto& info) { return info.param.name; });
GTEST_ALLOW_UNINSTANTIATED_PARAMETERIZED_TEST(LightsConformance);

}  // namespace
}  // namespace lacquer::test
