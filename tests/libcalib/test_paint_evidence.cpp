#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "libbrdf/brdf.h"
#include "libbrdf/error.h"
#include "libcalib/geometry_session.h"
#include "libcalib/paint_evidence.h"
#include "libcalib/quick_rig.h"
#include "test_support.h"

namespace lacquer::calib {
namespace {

constexpr double degree = 3.14159265358979323846 / 180;

acquire::RigGeometry nominal_rig() {
  acquire::RigGeometry g = test::quick_rig();
  g.lights[0].falloff_exponent = 20;
  return g;
}

struct Noise {
  double relative = 0;    ///< 1 sigma of a pixel
  double angle_rad = 0;   ///< of the turntable, against the one read back
  double dusty = 0;       ///< share of the pixels that have lost 70 % of their light
  double flicker = 0;     ///< of each view's light, relative
  double glare = 0;       ///< on the whole image, of its mean
};

struct Photographs {
  std::vector<PaintSample> samples;
  std::vector<PaintView> views;
};

/// Every pixel on its own: trace, illuminate, the paint's value; nothing of what is under test.
RadianceImage photograph(const acquire::RigGeometry& truth, const acquire::PlacedLight& light, const brdf::Brdf& paint, const Noise& noise, std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  RadianceImage image;
  image.width = truth.camera.width;
  image.height = truth.camera.height;
  const std::size_t n = static_cast<std::size_t>(image.width * image.height);
  image.radiance.assign(n, 0);
  image.variance.assign(n, 1);
  image.flags.assign(n, PixelFlag::valid);
  const double factor = 1 + noise.flicker * normal(random);
  double total = 0;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      const auto point = acquire::trace(truth, {x, y});
      const auto lit = point ? acquire::illuminate(light, *point) : std::nullopt;
      if (!lit) continue;
      const auto local = acquire::to_shading_frame(*point, lit->wi);
      const auto f = paint.value({local.wi, local.wo}, {});
      if (!f) continue;
      const double clean = 1e4 * factor * f->y * lit->irradiance.y * (uniform(random) < noise.dusty ? 0.3 : 1.0);
      const auto i = static_cast<std::size_t>(y * image.width + x);
      image.radiance[i] = static_cast<float>(clean * (1 + noise.relative * normal(random)));
      image.variance[i] = static_cast<float>(std::pow(noise.relative * clean, 2));
      total += clean;
    }
  if (noise.glare > 0)
    for (float& value : image.radiance) value += static_cast<float>(noise.glare * total / static_cast<double>(n));
  return image;
}

Photographs photographs(const acquire::RigGeometry& truth, const brdf::Brdf& paint, const Noise& noise, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  Calibration calibration;
  calibration.geometry = truth;
  Photographs p;
  const PaintBlocks blocks = paint_blocks(truth, 12);
  for (int view = 0; view < 12; ++view) {
    const double angle = 12 * view * degree;
    p.views.push_back({0, angle, 1});
    const acquire::PlacedLight light = truth.place_light(0, angle + noise.angle_rad * normal(random));
    add_paint_samples(photograph(truth, light, paint, noise, random), calibration, static_cast<std::uint32_t>(view), blocks, p.samples);
  }
  return p;
}

std::shared_ptr<const brdf::Brdf> matte_paint() { return brdf::load_brdf(test::source_dir() / "data-samples/paints/blue-matte.json"); }

double chi2(const GeometryEvidence& e, const GeometryUnknowns& unknowns, const std::vector<double>& x) {
  const std::vector<double> visible = unknowns.visible(unknowns.geometry(x), x);
  double sum = 0;
  for (std::size_t k = 0; k < e.rows.size(); ++k) {
    double v = -e.offset[k];
    for (std::size_t i = 0; i < x.size(); ++i) v += e.rows[k][i] * visible[i];
    sum += v * v;
  }
  return sum;
}

double chi2_at_the_truth(const Noise& noise, unsigned seeds) {
  const acquire::RigGeometry truth = nominal_rig();
  const GeometryUnknowns unknowns(truth, {}, {true});
  const std::vector<double> zero(unknowns.size());
  PaintOptions options;
  options.angle_rad = noise.angle_rad;
  if (noise.glare > 0) options.glare = options.glare_sigma = noise.glare / 2;
  double sum = 0, n = 0;
  for (unsigned seed = 1; seed <= seeds; ++seed) {
    const Photographs p = photographs(truth, *matte_paint(), noise, seed);
    const PaintEvidence e = paint_evidence(p.samples, p.views, unknowns, zero, options);
    EXPECT_GT(e.n_samples, 10000u);
    sum += chi2(e.geometry, unknowns, zero);
    n += static_cast<double>(e.geometry.rows.size());
  }
  return sum / n;
}

TEST(PaintEvidence, AtTheTruthItAsksForNoMoreThanItsErrorsExplain) {
  const double ratio = chi2_at_the_truth({.relative = 0.01, .angle_rad = 0.005 * degree}, 3);
  EXPECT_GT(ratio, 0.3);
  EXPECT_LT(ratio, 2.5);
}

TEST(PaintEvidence, DustDoesNotMoveIt) {
  const double ratio = chi2_at_the_truth({.relative = 0.01, .angle_rad = 0.005 * degree, .dusty = 0.002}, 1);
  EXPECT_LT(ratio, 3);
}

TEST(PaintEvidence, StrayLightAndAFlickerOfTheLedAreNoGeometry) {
  const double ratio = chi2_at_the_truth({.relative = 0.01, .flicker = 0.003, .glare = 0.002}, 1);
  EXPECT_LT(ratio, 3);
}

TEST(PaintEvidence, AMattePaintSaysWhereTheLightIsWithoutAnyHighlight) {
  const acquire::RigGeometry nominal = nominal_rig();
  acquire::RigGeometry truth = nominal;
  truth.lights[0].position = {0.012, 0.131, 0.598};  // 1.2 degrees round, 2 % too far
  const Photographs p = photographs(truth, *matte_paint(), {.relative = 0.01}, 7);
  const GeometryUnknowns unknowns(nominal, {}, {true});
  std::vector<double> x(unknowns.size());
  // The silhouette is known, and the turntable too.
  std::vector<EdgePoint> edges;
  for (int k = 0; k < 90; ++k) {
    const double a = 4 * degree * k;
    const glm::dvec2 centre = *nominal.camera.project(nominal.cam_from_rig.translation), out(std::cos(a), std::sin(a));
    double radius = 153;
    for (int i = 0; i < 20; ++i) radius -= *silhouette_distance(nominal, centre + radius * out);
    edges.push_back({centre + radius * out, 0.02});
  }
  GeometryEstimate e;
  for (int round = 0; round < 8; ++round) {
    e = solve_geometry(nominal, edges, {}, {}, paint_evidence(p.samples, p.views, unknowns, x, {}).geometry);
    for (std::size_t k = 0; k < x.size(); ++k) x[k] = e.uncertainty.parameters[k].correction / e.uncertainty.parameters[k].prior_sigma;
  }
  double direction = 0, distance = 0;
  for (const PaintView& view : p.views) {
    const glm::dvec3 found = e.geometry.place_light(0, view.turntable_angle * e.turntable_scale).position, real = truth.place_light(0, view.turntable_angle).position;
    direction = std::max(direction, glm::length(glm::normalize(found) - glm::normalize(real)));
    distance = std::max(distance, std::abs(glm::length(found) / glm::length(real) - 1));
  }
  EXPECT_LT(direction / degree, 0.05);
  EXPECT_LT(direction, 4 * e.light_sigma_rad);
  EXPECT_LT(distance, 0.01);
  EXPECT_LT(distance, 4 * e.distance_sigma);
}

TEST(PaintEvidence, DoesNotDependOnTheNumberOfThreads) {
  const acquire::RigGeometry truth = nominal_rig();
  const Photographs p = photographs(truth, *matte_paint(), {.relative = 0.02}, 3);
  const GeometryUnknowns unknowns(truth, {}, {true});
  std::vector<std::vector<double>> offsets;
  for (const std::size_t threads : {1, 3}) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    offsets.push_back(paint_evidence(p.samples, p.views, unknowns, std::vector<double>(unknowns.size()), {}).geometry.offset);
  }
  EXPECT_EQ(offsets[0], offsets[1]);
}

TEST(PaintEvidence, ALightWithoutAHighlightDoesNotDisturbTheOthers) {
  acquire::RigGeometry truth = nominal_rig();
  truth.lights.push_back(truth.lights[0]);
  truth.lights[0].on_arm = false;
  truth.lights[0].position = {0.25, 0.05, -0.54};  // 155 degrees from the camera: its highlight is at the silhouette
  acquire::RigGeometry nominal = truth;
  nominal.lights[1].position += glm::dvec3(0.004, -0.005, 0.008);
  const std::shared_ptr<const brdf::Brdf> paint = brdf::load_brdf(test::source_dir() / "data-samples/paints/polaris-silber.json");
  std::vector<GeometryView> views;
  for (int k = 0; k < 15; ++k) {
    const std::size_t light = k < 3 ? 0 : 1;
    const double angle = 10 * k * degree;
    views.push_back({"L" + std::to_string(k), light, angle, 1, [&truth, paint, light, angle, k] {
                       std::mt19937_64 random(static_cast<unsigned>(k));
                       return photograph(truth, truth.place_light(light, angle), *paint, {.relative = 0.01}, random);
                     }});
  }
  Calibration calibration;
  calibration.geometry = nominal;
  const SessionGeometry found = estimate_geometry("test", nominal, {}, views, calibration, {}, {});
  EXPECT_GT(found.paint.n_samples, 10000u);
  for (const Highlight& h : found.highlights) EXPECT_EQ(h.light, 1u);
  ASSERT_EQ(found.estimate.uncertainty.parameters.size(), 12u + 6u);
  const glm::dvec3 moved = truth.lights[1].position - nominal.lights[1].position;
  for (const GeometryParameter& p : found.estimate.uncertainty.parameters) {
    if (p.name.starts_with("light 1")) EXPECT_EQ(p.paint_shift, 0) << p.name << " was not known before the paint";
    if (!p.name.starts_with("light 2")) continue;
    const double real = moved[p.name.back() - 'x'];
    EXPECT_LT(std::abs(p.correction - real), 4 * p.sigma) << p.name << ' ' << p.correction << ' ' << real;
    EXPECT_LT(p.sigma, 0.9 * p.prior_sigma) << p.name;
  }
}

/// Seen through a lens that is not the rig file's: at the true lens' numbers the evidence asks for nothing more, at the rig file's it does.
TEST(PaintEvidence, KnowsWhatTheLensMoves) {
  const acquire::RigGeometry nominal = nominal_rig();
  acquire::RigGeometry truth = nominal;
  truth.camera.focal *= 1.01;
  truth.camera.centre += glm::dvec2(3, -2);
  const Noise noise{.relative = 0.002};
  std::mt19937_64 random(5);
  Photographs p;
  Calibration calibration;
  calibration.geometry = nominal;  // samples are cut out through the lens of the rig file
  const PaintBlocks blocks = paint_blocks(nominal, 12);
  for (int view = 0; view < 12; ++view) {
    p.views.push_back({0, 12 * view * degree, 1});
    add_paint_samples(photograph(truth, truth.place_light(0, 12 * view * degree), *matte_paint(), noise, random), calibration, static_cast<std::uint32_t>(view), blocks, p.samples);
  }
  GeometryPriors priors;
  priors.lens_covariance = {900, 0, 0, 0, 0, 900, 0, 0, 0, 0, 9, 0, 0, 0, 0, 9};
  const GeometryUnknowns unknowns(nominal, priors, {true});
  ASSERT_EQ(unknowns.n_lens(), 4u);
  std::vector<double> wrong(unknowns.size()), right(unknowns.size());
  const char* const names[] = {"lens.fx", "lens.fy", "lens.cx", "lens.cy"};
  const double off[] = {30.55, 30.55, 3.0, -2.0};
  for (std::size_t k = 0; k < 4; ++k) {
    const GeometryParameter& p_k = unknowns.parameters()[unknowns.first_lens() + k];
    ASSERT_EQ(p_k.name, names[k]);
    right[unknowns.first_lens() + k] = off[k] / p_k.prior_sigma;
  }
  const GeometryEvidence at_truth = paint_evidence(p.samples, p.views, unknowns, right, {}).geometry, at_rig_file = paint_evidence(p.samples, p.views, unknowns, wrong, {}).geometry;
  const double n = static_cast<double>(at_truth.rows.size());
  EXPECT_LT(chi2(at_truth, unknowns, right) / n, 3);
  EXPECT_GT(chi2(at_rig_file, unknowns, wrong) / n, 30);
  // Linearised there, it knows how far the truth is: what is left is a small part of what there was.
  EXPECT_LT(chi2(at_rig_file, unknowns, right), 0.1 * chi2(at_rig_file, unknowns, wrong));
}

TEST(PaintEvidence, ADistantLightIsRefused) {
  acquire::RigGeometry rig = nominal_rig();
  rig.lights[0].distant = true;
  GeometryEvidence evidence;
  evidence.views = {{0, 0}};
  EXPECT_THROW(solve_geometry(rig, {}, {}, {}, evidence), Error);
}

TEST(PaintEvidence, OptionsThatAreNoNumbersAreRefused) {
  const double nan = std::nan("");
  for (double PaintOptions::*field : {&PaintOptions::blur, &PaintOptions::blur_sigma, &PaintOptions::glare, &PaintOptions::glare_sigma, &PaintOptions::angle_rad})
    for (const double value : {nan, -1e-3}) {
      PaintOptions o;
      o.*field = value;
      EXPECT_THROW(o.validate(), Error);
    }
}

TEST(PaintEvidence, AnImageDarkerThanItsNoiseGivesNoSamples) {
  Calibration calibration;
  calibration.geometry = nominal_rig();
  const acquire::CameraModel& camera = calibration.geometry.camera;
  RadianceImage image;
  image.layout = acquire::PixelLayout::mono;
  image.width = camera.width;
  image.height = camera.height;
  const std::size_t n = static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height);
  image.radiance.assign(n, -1.0F);
  image.variance.assign(n, 1e-6F);
  image.flags.assign(n, PixelFlag::valid);
  std::fill(image.radiance.begin() + static_cast<std::ptrdiff_t>(n / 2), image.radiance.begin() + static_cast<std::ptrdiff_t>(n / 2 + n / 4), 0.5F);
  std::vector<PaintSample> samples;
  add_paint_samples(image, calibration, 0, paint_blocks(calibration.geometry, 12), samples);
  EXPECT_TRUE(samples.empty());
}

TEST(PaintEvidence, TooFewSamplesSayNothing) {
  const acquire::RigGeometry truth = nominal_rig();
  Photographs p = photographs(truth, *matte_paint(), {.relative = 0.02}, 3);
  p.samples.resize(2000);
  const GeometryUnknowns unknowns(truth, {}, {true});
  const PaintEvidence e = paint_evidence(p.samples, p.views, unknowns, std::vector<double>(unknowns.size()), {});
  EXPECT_EQ(e.n_samples, 0u);
  EXPECT_TRUE(e.geometry.rows.empty());
}

}  // namespace
}  // namespace lacquer::calib
