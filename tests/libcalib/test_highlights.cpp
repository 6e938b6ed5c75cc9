#include "libcalib/highlights.h"

#include <gtest/gtest.h>

#include "libcalib/sphere_photograph.h"

namespace lacquer::calib {
namespace {

using test::Gloss;
using test::photograph;
using test::photographed_rig;

constexpr double degree = 3.14159265358979323846 / 180;

Calibration calibration_of(const acquire::RigGeometry& g) {
  Calibration c;
  c.geometry = g;
  return c;
}

/// A rig that is off as a builder's is once the silhouette has been fitted.
acquire::RigGeometry misplaced(acquire::RigGeometry g) {
  g.lights[0].position += glm::dvec3(0.006, -0.005, 0.012);
  return g;
}

/// Distance of what is found from the mirror pixel of the true rig; the second measurement begins with the true light.
double error_px(const acquire::RigGeometry& truth, const acquire::RigGeometry& guess, const RadianceImage& image, double angle) {
  const auto found = find_highlight(image, calibration_of(guess), 0, angle, {});
  EXPECT_EQ(found.fate, HighlightFate::found) << angle / degree << ": " << describe(found.fate);
  return glm::length(found.highlight.pixel - *mirror_pixel(truth, truth.place_light(0, angle).position));
}

TEST(Highlights, TheCentreIsTheMirrorPixel) {
  const auto g = photographed_rig();
  for (const double angle : {0.0, 40.0, 80.0, 110.0}) {
    const auto image = photograph(g, angle * degree, {}, 0.01, 3, 1);
    EXPECT_LT(error_px(g, g, image, angle * degree), 0.01) << angle;
    EXPECT_LT(error_px(g, misplaced(g), image, angle * degree), 0.1) << angle << ": from a light that is 14 mm off";
  }
}

TEST(Highlights, AMosaicIsAsGood) {
  const auto g = photographed_rig();
  const auto image = photograph(g, 0.7, {}, 0.01, 3, 2, acquire::PixelLayout::bayer_rggb);
  EXPECT_LT(error_px(g, g, image, 0.7), 0.015);
}

TEST(Highlights, ALobeFourTimesAsWideHasTheSameCentre) {
  const auto g = photographed_rig();
  // 1/(n.o) alone would move this lobe's centroid by 0.17 px.
  const auto image = photograph(g, 90 * degree, {.diffuse = 0.02, .height = 1, .m = 0.05}, 0.005, 3, 3);
  EXPECT_LT(error_px(g, g, image, 90 * degree), 0.03);
}

TEST(Highlights, ChromeIsFound) {
  const auto g = photographed_rig();
  const auto image = photograph(g, 0.5, {.diffuse = 1e-4, .height = 20, .m = 0.005}, 0.01, 5, 4);
  EXPECT_LT(error_px(g, g, image, 0.5), 0.1);
}

TEST(Highlights, TheErrorBarsAreNotTooSmall) {
  const auto g = photographed_rig();
  double sum = 0;
  constexpr int n = 6;
  for (unsigned seed = 0; seed < n; ++seed) {
    const double angle = 0.3 + 0.2 * seed;
    const auto found = find_highlight(photograph(g, angle, {}, 0.05, 3, seed), calibration_of(g), 0, angle, {});
    ASSERT_EQ(found.fate, HighlightFate::found);
    const glm::dvec2 d = found.highlight.pixel - *mirror_pixel(g, g.place_light(0, angle).position);
    sum += d.x * d.x / found.highlight.xx + d.y * d.y / found.highlight.yy;
  }
  EXPECT_LT(std::sqrt(sum / (2 * n)), 1.5);
}

HighlightFate fate(const RadianceImage& image, const acquire::RigGeometry& g, double angle) {
  return find_highlight(image, calibration_of(g), 0, angle, {}).fate;
}

TEST(Highlights, WhatIsNoHighlightIsSaid) {
  const auto g = photographed_rig();
  EXPECT_EQ(fate(photograph(g, 0.5, {.diffuse = 0.3, .height = 0}, 0.01, 1, 5), g, 0.5), HighlightFate::matte);
  EXPECT_EQ(fate(photograph(g, 0.5, {.diffuse = 0.05, .height = 0.2, .m = 0.4}, 0.01, 1, 5), g, 0.5), HighlightFate::matte) << "gloss without a peak";
  EXPECT_EQ(fate(photograph(g, 160 * degree, {}, 0.01, 1, 6), g, 160 * degree), HighlightFate::silhouette);

  auto moved = g;  // the lamp's image at the upper border
  moved.camera.centre.y = mirror_pixel(g, g.lights[0].position)->y > 0 ? 179.5 - mirror_pixel(g, g.lights[0].position)->y + 2 : 0;
  EXPECT_EQ(fate(photograph(moved, 0, {}, 0.01, 1, 7), moved, 0), HighlightFate::border);
}

TEST(Highlights, AClippedPeakIsFlaggedAndAClippedTipIsNot) {
  const auto g = photographed_rig();
  auto image = photograph(g, 0.5, {}, 0.01, 3, 8);
  const float top = *std::max_element(image.radiance.begin(), image.radiance.end());
  const auto clip = [&](float level) {
    auto clipped = image;
    for (std::size_t i = 0; i < clipped.radiance.size(); ++i)
      if (clipped.radiance[i] > level) {
        clipped.radiance[i] = level;
        clipped.flags[i] = PixelFlag::clipped;
      }
    return clipped;
  };
  EXPECT_EQ(fate(clip(0.05f * top), g, 0.5), HighlightFate::clipped);
  EXPECT_LT(error_px(g, g, clip(0.7f * top), 0.5), 0.02);
}

TEST(Highlights, ASecondLampIsNotAveragedIn) {
  const auto g = photographed_rig();
  auto second = g;
  second.lights[0].position += glm::dvec3(0.05, 0.0, 0);
  auto image = photograph(g, 0.5, {}, 0.01, 1, 9);
  const auto other = photograph(second, 0.5, {}, 0.01, 1, 10);
  for (std::size_t i = 0; i < image.radiance.size(); ++i) image.radiance[i] += 0.9f * other.radiance[i];
  EXPECT_EQ(fate(image, g, 0.5), HighlightFate::two_peaks);
}

}  // namespace
}  // namespace lacquer::calib
