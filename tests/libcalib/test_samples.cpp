#include "libcalib/samples.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <random>
#include <glm/geometric.hpp>
#include <numbers>

#include "libbrdf/error.h"
#include "test_support.h"

namespace lacquer::calib {
namespace {

constexpr double pi = std::numbers::pi;

/// Orthographic camera, 1 mm per pixel, sphere of 50 mm in the middle of 121 x 121 pixels: normals can be written down by hand.
Calibration orthographic_rig(bool distant) {
  Calibration c;
  c.geometry.camera.projection = acquire::CameraModel::Projection::orthographic;
  c.geometry.camera.width = c.geometry.camera.height = 121;
  c.geometry.camera.focal = {1000, 1000};
  c.geometry.camera.centre = {60, 60};
  c.geometry.cam_from_rig = acquire::look_at({0, 0, 1}, {0, 0, 0}, {0, 1, 0});
  c.geometry.sphere_radius = 0.05;
  acquire::Light light;
  light.distant = distant;
  light.direction = glm::normalize(glm::dvec3(0.3, 0.5, 0.8));
  light.position = {0.3, 0.5, 0.8};
  light.intensity = {2.0, 3.0, 5.0};
  c.geometry.lights = {light};
  c.dn_per_radiance = {100, 200, 400};
  return c;
}

glm::dvec3 normal_at(int x, int y) {
  const double nx = (x - 60) / 50.0, ny = -(y - 60) / 50.0;  // image y points down, rig y up
  return {nx, ny, std::sqrt(1 - nx * nx - ny * ny)};
}

RadianceImage constant_image(acquire::PixelLayout layout, float value) {
  RadianceImage image;
  image.width = image.height = 121;
  image.layout = layout;
  const std::size_t n = 121u * 121u * static_cast<std::size_t>(acquire::values_per_pixel(layout));
  image.radiance.assign(n, value);
  image.variance.assign(n, 0.25f);
  image.flags.assign(n, PixelFlag::valid);
  return image;
}

std::vector<Sample> all_samples(const Sampler& sampler, const RadianceImage& image, SampleCounts* counts = nullptr) {
  std::vector<Sample> all;
  const SampleCounts c = sampler.sample_view(image, {}, [&](std::span<const Sample> s) { all.insert(all.end(), s.begin(), s.end()); });
  if (counts) *counts = c;
  return all;
}

TEST(Samples, ValueAndCoordinatesOfADistantLightFollowFromTheNormalByHand) {
  const Calibration calibration = orthographic_rig(true);
  const Sampler sampler(calibration, {}, acquire::PixelLayout::rgb, {});
  const auto samples = all_samples(sampler, constant_image(acquire::PixelLayout::rgb, 7.0f));

  const glm::dvec3 wi = glm::normalize(glm::dvec3(0.3, 0.5, 0.8)), wo(0, 0, 1), h = glm::normalize(wi + wo);
  constexpr double normal_step = 0x1p-24;  // of the floats that a pixel's normal is kept in
  std::size_t next = 0;
  for (int y = 0; y < 121; ++y)
    for (int x = 0; x < 121; ++x) {
      if (std::hypot(x - 60, y - 60) > 47.5) continue;  // well inside the band of edge_px = 2
      const glm::dvec3 n = normal_at(x, y);
      if (glm::dot(n, wi) < 0.0872 || n.z < 0.0872) continue;
      const double theta_h = std::acos(std::min(1.0, glm::dot(n, h)));
      // Find this pixel's three samples: they come in pixel order.
      while (next < samples.size() && std::abs(samples[next].coordinates.theta_h - theta_h) > 4 * normal_step) ++next;
      ASSERT_LT(next + 2, samples.size()) << "pixel " << x << "," << y << " has no sample";
      for (int c = 0; c < 3; ++c) {
        const Sample& s = samples[next + static_cast<std::size_t>(c)];
        const double irradiance = calibration.geometry.lights[0].intensity[c] * glm::dot(n, wi);
        EXPECT_EQ(s.channel, c);
        const double relative = 2 * normal_step / glm::dot(n, wi);
        EXPECT_NEAR(s.value, 7.0 / (calibration.dn_per_radiance[c] * irradiance), relative * s.value);
        EXPECT_NEAR(s.variance, 0.25 / std::pow(calibration.dn_per_radiance[c] * irradiance, 2), 2 * relative * s.variance);
        EXPECT_NEAR(s.weight, glm::dot(n, wi), 2 * normal_step);
        EXPECT_NEAR(s.coordinates.theta_d, std::acos(glm::dot(wi, h)), 1e-12);  // the same for every pixel: both directions are fixed
      }
      next += 3;
    }
}

TEST(Samples, IrradianceOfANearLightFallsWithTheSquareOfItsDistance) {
  const Calibration calibration = orthographic_rig(false);
  SampleOptions options;
  options.min_cosine = 0.5;
  const Sampler sampler(calibration, {}, acquire::PixelLayout::mono, options);
  RadianceImage image = constant_image(acquire::PixelLayout::mono, 0.0f);
  image.radiance[60 * 121 + 60] = 9.0f;  // the pixel that looks at (0, 0, R)
  const auto samples = all_samples(sampler, image);
  double found = 0;
  for (const Sample& s : samples)
    if (s.value != 0) found = s.value;
  const glm::dvec3 to_light = glm::dvec3(0.3, 0.5, 0.8) - glm::dvec3(0, 0, 0.05);
  const double d2 = glm::dot(to_light, to_light), cosine = to_light.z / std::sqrt(d2);
  EXPECT_NEAR(found, 9.0 / (100 * 2.0 * cosine / d2), 1e-12);
}

TEST(Samples, ClippedValuesAreBoundsAndInvalidOnesAreNeverDelivered) {
  const Sampler sampler(orthographic_rig(true), {}, acquire::PixelLayout::mono, {});
  RadianceImage image = constant_image(acquire::PixelLayout::mono, 1.0f);
  SampleCounts before, after;
  const auto n_before = all_samples(sampler, image, &before).size();
  image.flags[60 * 121 + 60] = PixelFlag::clipped;
  image.flags[60 * 121 + 61] = PixelFlag::invalid;
  image.flags[60 * 121 + 62] = PixelFlag::dark;  // a dark value is an ordinary, if noisy, measurement
  const auto samples = all_samples(sampler, image, &after);
  EXPECT_EQ(samples.size(), n_before - 1);
  EXPECT_EQ(std::count_if(samples.begin(), samples.end(), [](const Sample& s) { return s.clipped; }), 1);
  EXPECT_EQ(after.clipped, 1u);
  EXPECT_EQ(after.invalid, 1u);
  EXPECT_EQ(after.used, samples.size() - 1);
}

TEST(Samples, MosaicPixelFeedsItsOwnChannelOnly) {
  const Sampler sampler(orthographic_rig(true), {}, acquire::PixelLayout::bayer_rggb, {});
  std::size_t per_channel[3] = {};
  for (const Sample& s : all_samples(sampler, constant_image(acquire::PixelLayout::bayer_rggb, 1.0f))) ++per_channel[s.channel];
  EXPECT_NEAR(static_cast<double>(per_channel[1]) / static_cast<double>(per_channel[0]), 2.0, 0.05);
  EXPECT_NEAR(static_cast<double>(per_channel[1]) / static_cast<double>(per_channel[2]), 2.0, 0.05);
}

TEST(Samples, UpperHalfSphereMaskLeavesOutTheLowerHalf) {
  acquire::MaskDescription mask;
  mask.min_y = 0.0;
  SampleCounts whole, upper;
  const RadianceImage image = constant_image(acquire::PixelLayout::mono, 1.0f);
  Calibration calibration = orthographic_rig(true);
  calibration.geometry.lights[0].direction = {0, 0, 1};  // light and camera treat both halves alike
  all_samples(Sampler(calibration, {}, acquire::PixelLayout::mono, {}), image, &whole);
  all_samples(Sampler(calibration, mask, acquire::PixelLayout::mono, {}), image, &upper);
  EXPECT_NEAR(static_cast<double>(upper.used) / static_cast<double>(whole.used), 0.5, 0.01);
}

TEST(Samples, PredictionIsTheInverseOfSampling) {
  const Calibration calibration = orthographic_rig(false);
  const Sampler sampler(calibration, {}, acquire::PixelLayout::rgb, {});
  const brdf::CookTorranceBrdf paint({glm::dvec3(0.2, 0.3, 0.4), {{glm::dvec3(0.1, 0.2, 0.3), 0.2, 0.5}}});
  const auto prediction = sampler.predict_view(paint, {});
  RadianceImage image = constant_image(acquire::PixelLayout::rgb, 0.0f);
  image.radiance = prediction.radiance;
  std::size_t n = 0;
  for (const Sample& s : all_samples(sampler, image)) {
    const auto f = paint.value(brdf::directions(s.coordinates), s.footprint);
    EXPECT_NEAR(s.value / (*f)[s.channel], 1.0, 1e-6);  // radiance is stored as float
    ++n;
  }
  EXPECT_GT(n, 10000u);
}

/// The rig above seen through a lens near by, under a near light with a falloff and an emitter of some size.
Calibration pinhole_rig() {
  Calibration c = orthographic_rig(false);
  c.geometry.camera.projection = acquire::CameraModel::Projection::pinhole;
  c.geometry.camera.focal = {1000, 1010};
  c.geometry.camera.distortion = {-0.2, 0.5, 2e-4, -1e-4};
  c.geometry.lights[0].falloff_exponent = 20;
  c.geometry.lights[0].diameter = 0.003;
  c.lens_blur_px = 0.7;
  c.vignetting = 0.08;
  return c;
}

/// Irregular values, some clipped or invalid.
RadianceImage irregular_image(acquire::PixelLayout layout, unsigned seed = 5) {
  RadianceImage image = constant_image(layout, 1.0f);
  std::mt19937 generator(seed);
  std::uniform_real_distribution<float> uniform(1, 10);
  for (std::size_t i = 0; i < image.radiance.size(); ++i) {
    image.radiance[i] = uniform(generator);
    image.variance[i] = 0.1f * uniform(generator);
    if ((i + seed) % 11 == 0) image.flags[i] = PixelFlag::clipped;
    if ((i + seed) % 13 == 0) image.flags[i] = PixelFlag::invalid;
  }
  return image;
}

/// Three views, which are not a multiple of those taken at once.
struct ThreeViews {
  std::array<RadianceImage, 3> images;
  std::array<LitImage, 3> lit;
  explicit ThreeViews(acquire::PixelLayout layout) : images{irregular_image(layout, 5), irregular_image(layout, 6), irregular_image(layout, 7)} {
    for (std::size_t v = 0; v < 3; ++v) lit[v] = {&images[v], {.turntable_angle = std::array{0.0, 0.02, 0.4}[v]}};
  }
  ThreeViews(const ThreeViews&) = delete;
};

/// Sums of a plain loop over samples, in double.
struct PlainSums {
  double weight = 0, value = 0, variance = 0, theta_h = 0, theta_d = 0, phi_d = 0, along = 0, across = 0, mixed = 0, slope = 0, slope2 = 0;
  std::uint32_t count = 0;
  void add(const Sample& s) {
    weight += s.weight, value += s.weight * s.value, variance += s.weight * s.weight * s.variance;
    theta_h += s.weight * s.coordinates.theta_h, theta_d += s.weight * s.coordinates.theta_d, phi_d += s.weight * brdf::fold_phi_d(s.coordinates.phi_d);
    along += s.weight * s.footprint.along, across += s.weight * s.footprint.across, mixed += s.weight * s.footprint.mixed;
    const double tangent = std::tan(s.coordinates.theta_h);
    slope += s.weight * tangent, slope2 += s.weight * tangent * tangent;
    ++count;
  }
};

void expect_fast_equals_plain(const Calibration& calibration, acquire::PixelLayout layout) {
  const Sampler sampler(calibration, {}, layout, {});
  const ThreeViews views(layout);
  const auto n_channels = static_cast<std::size_t>(acquire::n_channels(layout));
  brdf::TableAccumulator accumulator(n_channels);
  const SampleCounts fast = sampler.accumulate_views(views.lit, accumulator);
  const brdf::HalfAngleTable table = accumulator.table(false);

  std::vector<std::map<std::size_t, PlainSums>> values(n_channels), bounds(n_channels);
  SampleCounts plain;
  for (const LitImage& view : views.lit)
    plain += sampler.sample_view(*view.image, view.lighting, [&](std::span<const Sample> samples) {
      for (const Sample& s : samples) (s.clipped ? bounds : values)[static_cast<std::size_t>(s.channel)][brdf::TableGrid::index(s.coordinates)].add(s);
    });
  EXPECT_EQ(fast.used, plain.used);
  EXPECT_EQ(fast.clipped, plain.clipped);
  EXPECT_EQ(fast.invalid, plain.invalid);
  EXPECT_EQ(fast.grazing, plain.grazing);
  EXPECT_EQ(fast.blurred, plain.blurred);
  EXPECT_EQ(fast.masked, plain.masked);
  for (std::size_t c = 0; c < n_channels; ++c) {
    const auto& t = table.channels[c];
    std::size_t n_values = 0;
    for (const auto& [i, s] : values[c]) {
      ASSERT_EQ(t.origin[i], brdf::CellOrigin::measured);
      ASSERT_EQ(t.count[i], s.count);
      ++n_values;
      EXPECT_NEAR(t.mean[i] / (s.value / s.weight), 1, 1e-6);
      EXPECT_NEAR(t.variance[i] / (s.variance / (s.weight * s.weight)), 1, 3e-6);
      EXPECT_NEAR(t.theta_h[i], s.theta_h / s.weight, 1e-6);
      EXPECT_NEAR(t.theta_d[i], s.theta_d / s.weight, 1e-6);
      const double sines = std::sin(s.theta_h / s.weight) * std::sin(s.theta_d / s.weight);
      EXPECT_NEAR(t.phi_d[i], s.phi_d / s.weight, 1e-6 + 2e-6 / sines);  // at the peak phi_d turns fast
      const double spread = (s.along + s.across) / s.weight;
      EXPECT_NEAR(t.footprint_across[i], s.across / s.weight, 1e-3 * spread);
      const double scatter = std::max(0.0, s.slope2 / s.weight - std::pow(s.slope / s.weight, 2));  // of the samples in the cell
      if (t.theta_h[i] > 0.9 * pi / 9) continue;  // only narrow lobes need it
      EXPECT_NEAR(t.footprint_along[i], s.along / s.weight + scatter, 1e-3 * spread + 0.1 * scatter + 1e-9);
    }
    for (const auto& [i, s] : bounds[c]) {
      if (values[c].contains(i)) continue;
      ASSERT_EQ(t.origin[i], brdf::CellOrigin::clipped);
      ASSERT_EQ(t.count[i], s.count);
      EXPECT_NEAR(t.mean[i] / (s.value / s.weight), 1, 1e-6);
    }
    EXPECT_EQ(std::count(t.origin.begin(), t.origin.end(), brdf::CellOrigin::measured), static_cast<std::ptrdiff_t>(n_values));
  }
}

TEST(Samples, FastAccumulationEqualsThePlainLoopCellByCell) {
  for (const auto layout : {acquire::PixelLayout::bayer_rggb, acquire::PixelLayout::rgb, acquire::PixelLayout::mono})
    for (const Calibration& calibration : {pinhole_rig(), orthographic_rig(false), orthographic_rig(true)}) expect_fast_equals_plain(calibration, layout);
}

TEST(Samples, SoItDoesWithLightAndCameraTwoRadiiFromTheSpheresCentre) {
  Calibration calibration = pinhole_rig();
  calibration.geometry.lights[0].position = 0.1 * glm::normalize(glm::dvec3(0.3, 0.5, 0.8));
  calibration.geometry.cam_from_rig = acquire::look_at({0, 0, 0.1}, {0, 0, 0}, {0, 1, 0});
  calibration.geometry.camera.focal = {80, 80};
  expect_fast_equals_plain(calibration, acquire::PixelLayout::bayer_rggb);
}

TEST(Samples, SoItDoesWithoutTheProcessorsVectors) {
  use_sample_vectors(false);
  expect_fast_equals_plain(pinhole_rig(), acquire::PixelLayout::bayer_rggb);
  use_sample_vectors(true);
}

TEST(Samples, AccumulationGivesTheSameBytesForAnyNumberOfThreads) {
  const Sampler sampler(pinhole_rig(), {}, acquire::PixelLayout::bayer_rggb, {});
  const ThreeViews views(acquire::PixelLayout::bayer_rggb);
  const auto table = [&](unsigned threads) {
    tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    brdf::TableAccumulator accumulator(3);
    sampler.accumulate_views(views.lit, accumulator);
    return accumulator.table(true);
  };
  const auto one = table(1);
  for (const auto& other : {table(2), table(4)})
    for (std::size_t c = 0; c < 3; ++c) {
      EXPECT_TRUE(one.channels[c].mean == other.channels[c].mean);
      EXPECT_TRUE(one.channels[c].variance == other.channels[c].variance);
      EXPECT_TRUE(one.channels[c].phi_d == other.channels[c].phi_d);
      EXPECT_TRUE(one.channels[c].footprint_mixed == other.channels[c].footprint_mixed);
      EXPECT_TRUE(one.channels[c].origin == other.channels[c].origin);
    }
}

TEST(Samples, WhereAPartOfTheEmitterIsBelowTheHorizonThereIsNoSample) {
  Calibration calibration = orthographic_rig(false);
  SampleOptions options;
  options.min_cosine = 0.01;
  const auto smallest_cosine = [&](double diameter) {
    calibration.geometry.lights[0].diameter = diameter;
    const Sampler sampler(calibration, {}, acquire::PixelLayout::mono, options);
    double smallest = 1;
    for (const Sample& s : all_samples(sampler, constant_image(acquire::PixelLayout::mono, 1.0f)))
      smallest = std::min(smallest, brdf::half_angle_cosines(s.coordinates).n_dot_i);
    return smallest;
  };
  EXPECT_LT(smallest_cosine(0), 0.03);
  // Radius 0.1 m, at least 0.9899 - 0.05 m away and at most 0.9899: the sine of the half angle is 0.101 to 0.1064.
  EXPECT_GT(smallest_cosine(0.2), 0.101);
  EXPECT_LT(smallest_cosine(0.2), 0.12);
}

TEST(Samples, ImageOfAnotherSizeIsRefused) {
  const Sampler sampler(orthographic_rig(true), {}, acquire::PixelLayout::mono, {});
  RadianceImage image = constant_image(acquire::PixelLayout::mono, 1.0f);
  image.width = 120;
  EXPECT_THROW(all_samples(sampler, image), Error);
}

TEST(Samples, MaskOfAnotherSizeIsAnErrorThatNamesBothSizes) {
  test::TemporaryFolder folder;
  test::write_file(folder / "mask.pgm", "P5\n2 1\n255\n\xff\xff");
  acquire::MaskDescription mask;
  mask.file = folder / "mask.pgm";
  try {
    Sampler(orthographic_rig(true), mask, acquire::PixelLayout::mono, {});
    FAIL() << "accepted";
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("expected 121x121 pixels as the camera has, got 2x1"), std::string::npos) << e.what();
  }
}

}  // namespace
}  // namespace lacquer::calib
