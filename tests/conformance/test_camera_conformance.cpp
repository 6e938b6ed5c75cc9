#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "conformance/expect_error.h"
#include "conformance/peers.h"

namespace lacquer::test {
namespace {

double mean_of(const acquire::RawFrame& frame) {
  return std::accumulate(frame.data.begin(), frame.data.end(), 0.0) / static_cast<double>(frame.data.size());
}

class CameraConformance : public testing::TestWithParam<PeerMaker<CameraPeer>> {
 protected:
  std::unique_ptr<CameraPeer> peer = GetParam().make();

  void expect_mean(const acquire::RawFrame& frame, double factor = 1) {
    const double expected = factor * peer->expected_mean(frame.actual.exposure_s);
    EXPECT_NEAR(mean_of(frame), expected, peer->tolerance() * expected + 1) << frame.actual.exposure_s << " s";  // 1: rounding to counts
  }
};

TEST_P(CameraConformance, DeliversTheFormatThatTheRigStates) {
  const auto camera = peer->open();
  const auto frame = camera->capture({peer->exposures_s().front(), 0});
  EXPECT_EQ(frame.width, peer->width());
  EXPECT_EQ(frame.height, peer->height());
  EXPECT_EQ(frame.bits, peer->bits());
  EXPECT_FALSE(camera->description().empty());
  EXPECT_EQ(camera->warning(), "");
}

TEST_P(CameraConformance, EveryFrameIsNewAfterAChangeOfExposure) {
  const auto camera = peer->open();
  const auto exposures = peer->exposures_s();
  // Up, down and back and forth between the ends: an old frame would be wrong by more than the tolerance.
  std::vector<double> order = exposures;
  order.insert(order.end(), exposures.rbegin(), exposures.rend());
  for (int i = 0; i < 3; ++i) order.insert(order.end(), {exposures.front(), exposures.back()});
  for (const double exposure : order) expect_mean(camera->capture({exposure, 0}));
}

TEST_P(CameraConformance, EveryFrameIsNewAfterAChangeOfLight) {
  const auto camera = peer->open();
  const double exposure = peer->exposures_s().front();
  camera->capture({exposure, 0});
  for (const double factor : {0.5, 1.0, 0.25, 1.0}) {
    if (!peer->set_brightness(factor)) GTEST_SKIP() << "the scene of this peer cannot be changed";
    const auto frame = camera->capture({exposure, 0});
    const double dark = peer->expected_mean(0), light = peer->expected_mean(frame.actual.exposure_s) - dark;
    EXPECT_NEAR(mean_of(frame), dark + factor * light, peer->tolerance() * light + 1) << "brightness " << factor;
  }
}

TEST_P(CameraConformance, ReadsBackWhatTheDeviceDoes) {
  const auto camera = peer->open();
  for (const double exposure : peer->exposures_s()) {
    const double asked = exposure * 1.00037;  // no whole number of anything
    const auto frame = camera->capture({asked, 0});
    EXPECT_NEAR(frame.actual.exposure_s, asked, 0.05 * asked + 1e-4);
    if (const auto device = peer->exposure_in_device()) {
      EXPECT_NEAR(frame.actual.exposure_s, *device, 1e-9);
    }
  }
}

TEST_P(CameraConformance, RefusesExposuresBeyondItsRangeAndGoesOn) {
  const auto camera = peer->open();
  const auto limits = camera->limits();
  expect_error(ErrorCode::usage, "the camera takes", [&] { camera->capture({limits.max_exposure_s * 2, 0}); });
  expect_error(ErrorCode::usage, "the camera takes", [&] { camera->capture({limits.min_exposure_s / 2, 0}); });
  expect_error(ErrorCode::usage, "gain", [&] { camera->capture({peer->exposures_s().front(), limits.max_gain_db + 10}); });
  expect_error(ErrorCode::usage, "expected a finite", [&] { camera->capture({std::nan(""), 0}); });
  expect_mean(camera->capture({peer->exposures_s().back(), 0}));
}

TEST_P(CameraConformance, OpensAgain) {
  for (int i = 0; i < 3; ++i) expect_mean(peer->open()->capture({peer->exposures_s()[static_cast<std::size_t>(i) % peer->exposures_s().size()], 0}));
}

TEST_P(CameraConformance, ClosesWithoutACapture) { peer->open(); }

TEST_P(CameraConformance, NoFrameIsATimeoutAndTheNextOneIsNew) {
  const auto camera = peer->open();
  const auto exposures = peer->exposures_s();
  expect_mean(camera->capture({exposures.front(), 0}));
  if (!peer->stop_frames(true)) GTEST_SKIP() << "always delivers";
  expect_error(ErrorCode::timeout, "", [&] { camera->capture({exposures.back(), 0}); });
  ASSERT_TRUE(peer->stop_frames(false));
  expect_mean(camera->capture({exposures.front(), 0}));
  expect_mean(camera->capture({exposures.back(), 0}));
}

TEST_P(CameraConformance, UnpluggedIsAnErrorAndPluggedInWorksAgain) {
  auto camera = peer->open();
  camera->capture({peer->exposures_s().front(), 0});
  if (!peer->unplug()) GTEST_SKIP() << "no plug to pull";
  try {
    camera->capture({peer->exposures_s().back(), 0});
    ADD_FAILURE() << "a frame from an unplugged camera";
  } catch (const Error& e) {
    EXPECT_TRUE(e.code() == ErrorCode::device || e.code() == ErrorCode::timeout) << e.what();
  }
  camera.reset();
  ASSERT_TRUE(peer->plug_in());
  camera = peer->open();
  expect_mean(camera->capture({peer->exposures_s().front(), 0}));
}

INSTANTIATE_TEST_SUITE_P(Devices, CameraConformance, testing::ValuesIn(camera_peers()), [](const auto& info) { return info.param.name; });
GTEST_ALLOW_UNINSTANTIATED_PARAMETERIZED_TEST(CameraConformance);

}  // namespace
}  // namespace lacquer::test
