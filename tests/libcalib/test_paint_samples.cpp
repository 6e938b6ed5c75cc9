#include "libcalib/paint_samples.h"

#include <gtest/gtest.h>

#include <cmath>

#include "libcalib/quick_rig.h"

namespace lacquer::calib {
namespace {

/// ln(radiance) is linear in the image's x, with a slope for each colour.
RadianceImage ramp(const acquire::CameraModel& camera, const std::array<double, 3>& slope) {
  RadianceImage image;
  image.layout = acquire::PixelLayout::bayer_rggb;
  image.width = camera.width;
  image.height = camera.height;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      const double value = std::exp(slope[static_cast<std::size_t>(acquire::channel_of(image.layout, x, y, 0))] * (x - 240));
      image.radiance.push_back(static_cast<float>(value));
      image.variance.push_back(static_cast<float>(1e-8 * value * value));
      image.flags.push_back(PixelFlag::valid);
    }
  return image;
}

// In a block of 4 x 4 pixels red lies half a pixel before the middle, blue half a pixel behind. Weights 0, 1/4, 1/4, 1/2 bring both into the middle;
// their squares leave 8/3 of 4 values, the green ones are 8: the colours share by 0.2, 0.6, 0.2.
TEST(PaintSamples, ColoursOfDifferentSlopesMeetInTheBlocksMiddle) {
  Calibration calibration;
  calibration.geometry = test::quick_rig(1);
  const acquire::CameraModel& camera = calibration.geometry.camera;
  const std::array<double, 3> slope{0.01, 0.003, -0.008};
  std::vector<PaintSample> samples;
  add_paint_samples(ramp(camera, slope), calibration, 0, {4, 8}, samples);
  ASSERT_GT(samples.size(), 500u);
  for (const PaintSample& s : samples) {
    const double x = camera.project(s.sight)->x - 240;
    EXPECT_NEAR(s.log_radiance, (0.2 * slope[0] + 0.6 * slope[1] + 0.2 * slope[2]) * x, 2e-6);
    EXPECT_NEAR(s.moment, (0.6 * 1.25 + 0.4 * 0.75) / 1.25, 1e-12);
    EXPECT_NEAR(s.skew, -0.25 / 1.25, 1e-12);
  }
}

// One red and one blue pixel cannot be weighted into the middle of a block of 2 x 2.
TEST(PaintSamples, TheSmallestBlockOfAMosaicIsGreenOnly) {
  Calibration calibration;
  calibration.geometry = test::quick_rig(1);
  const acquire::CameraModel& camera = calibration.geometry.camera;
  std::vector<PaintSample> samples;
  add_paint_samples(ramp(camera, {0.01, 0.003, -0.008}), calibration, 0, {2, 8}, samples);
  ASSERT_GT(samples.size(), 500u);
  for (const PaintSample& s : samples) EXPECT_NEAR(s.log_radiance, 0.003 * (camera.project(s.sight)->x - 240), 2e-6);
}

}  // namespace
}  // namespace lacquer::calib
