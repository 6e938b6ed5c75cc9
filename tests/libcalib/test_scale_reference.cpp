#include "libcalib/scale_reference.h"

#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "libbrdf/error.h"
#include "test_support.h"

namespace lacquer::calib {
namespace {

Calibration rig_with_one_light(const glm::dvec3& position) {
  Calibration c;
  auto& g = c.geometry;
  g.camera.width = 160, g.camera.height = 120;
  g.camera.focal = {900, 900};
  g.camera.centre = {79.5, 59.5};
  g.cam_from_rig = acquire::look_at({0, 0, 1}, {0, 0, 0}, {0, 1, 0});
  acquire::Light light;
  light.position = position;
  g.lights = {light};
  return c;
}

std::shared_ptr<const brdf::Brdf> white(double reflectance) {
  brdf::CookTorrance model;
  model.kd = glm::dvec3(reflectance);
  return std::make_shared<brdf::CookTorranceBrdf>(model);
}

/// A white plate in the plane z = 0, in plain trigonometry: L = rho/pi I cos^g(a) cos(t) / d^2. Pixel (x, y) sees the point ((x - cx), -(y - cy)) / 900 m.
RadianceImage plate_image(const glm::dvec3& light, double rho, double intensity, double g, double noise, unsigned seed) {
  RadianceImage image;
  image.width = 160, image.height = 120;
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 160; ++x) {
      const glm::dvec3 p((x - 79.5) / 900, -(y - 59.5) / 900, 0), d = light - p;
      const double cos_axis = glm::dot(glm::normalize(light), glm::normalize(d)), cos_i = glm::normalize(d).z;
      const double radiance = rho / 3.141592653589793 * intensity * std::pow(cos_axis, g) * cos_i / glm::dot(d, d);
      image.radiance.push_back(static_cast<float>(radiance * (1 + noise * normal(random))));
      image.variance.push_back(static_cast<float>(noise * noise * radiance * radiance));
      image.flags.push_back(PixelFlag::valid);
    }
  return image;
}

ScaleReference plate() {
  ScaleReference r;
  r.brdf = white(0.9);
  r.plate = ScaleReference::Plate{.pixels = {10, 10, 140, 100}};
  return r;
}

TEST(ScaleReference, APlateGivesIntensityAndFalloffWithinTheirErrorsOverSeeds) {
  const glm::dvec3 light(0.1, 0.2, 0.55);
  const Calibration c = rig_with_one_light(light);
  double chi_intensity = 0, chi_falloff = 0;
  constexpr unsigned n_seeds = 40;
  for (unsigned seed = 0; seed < n_seeds; ++seed) {
    const LightScale s = light_scale(plate_image(light, 0.9, 0.7, 12, 0.02, seed), c, 0, 0, 1, plate());
    chi_intensity += std::pow(std::log(s.factor.g / 0.7) / s.factor_sigma.g, 2) / n_seeds;
    chi_falloff += std::pow((s.falloff_exponent - 12) / s.falloff_sigma, 2) / n_seeds;
    EXPECT_NEAR(s.rms, 0.02, 0.002);
  }
  // 40 squares with some 30 regions behind each sigma: 1 +- 0.25.
  EXPECT_NEAR(chi_intensity, 1, 0.65);
  EXPECT_NEAR(chi_falloff, 1, 0.65);
}

TEST(ScaleReference, WithoutNoiseTheyAreExact) {
  const glm::dvec3 light(0.1, 0.2, 0.55);
  const LightScale s = light_scale(plate_image(light, 0.9, 0.7, 12, 0, 1), rig_with_one_light(light), 0, 0, 1, plate());
  EXPECT_NEAR(s.factor.r, 0.7, 1e-6);
  EXPECT_NEAR(s.falloff_exponent, 12, 1e-4);
  // A light that had drifted to 80 % in that view is 1/0.8 as bright at the start.
  EXPECT_NEAR(light_scale(plate_image(light, 0.9, 0.7, 12, 0, 1), rig_with_one_light(light), 0, 0, 0.8, plate()).factor.r, 0.7 / 0.8, 1e-6);
}

TEST(ScaleReference, FingerprintsAndDustAreLeftOut) {
  const glm::dvec3 light(0.1, 0.2, 0.55);
  RadianceImage image = plate_image(light, 0.9, 0.7, 12, 0.01, 1);
  for (int y = 40; y < 60; ++y)
    for (int x = 50; x < 70; ++x) image.radiance[static_cast<std::size_t>(y * 160 + x)] *= 0.6f;
  const LightScale s = light_scale(image, rig_with_one_light(light), 0, 0, 1, plate());
  EXPECT_GE(s.n_left_out, 400u);
  EXPECT_NEAR(s.factor.r, 0.7, 0.7 * 4 * s.factor_sigma.r + 1e-4);
}

TEST(ScaleReference, WhatCannotBeIsSaid) {
  const glm::dvec3 light(0.1, 0.2, 0.55);
  const Calibration c = rig_with_one_light(light);
  const auto error_of = [&](const RadianceImage& image, const ScaleReference& reference) {
    try {
      light_scale(image, c, 0, 0, 1, reference);
    } catch (const Error& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  RadianceImage black = plate_image(light, 0.9, 0.7, 12, 0, 1);
  std::fill(black.radiance.begin(), black.radiance.end(), 0.f);
  EXPECT_NE(error_of(black, plate()).find("no light on it"), std::string::npos);
  std::fill(black.flags.begin(), black.flags.end(), PixelFlag::clipped);
  EXPECT_NE(error_of(black, plate()).find("0 usable values"), std::string::npos);
  ScaleReference without;
  EXPECT_NE(error_of(black, without).find("its reflectance is missing"), std::string::npos);
  // Brighter away from the axis: the light looks elsewhere.
  EXPECT_NE(error_of(plate_image(light, 0.9, 0.7, -5, 0, 1), plate()).find("is the light aimed at the reference?"), std::string::npos);
}

}  // namespace
}  // namespace lacquer::calib
