#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "libbrdf/brdf.h"
#include "libcalib/paint_evidence.h"
#include "test_support.h"

namespace lacquer::calib {
namespace {

constexpr double degree = 3.14159265358979323846 / 180;

acquire::RigGeometry nominal_rig() {
  acquire::RigGeometry g;
  g.camera.width = 480;
  g.camera.height = 360;
  g.camera.focal = glm::dvec2(3055);
  g.camera.centre = {239.5, 179.5};
  g.camera.distortion = {-0.2, 0.5, 2e-4, -1e-4, 0, 0, 0, 0};
  g.cam_from_rig = acquire::look_at({0, 0, 1}, {0, 0, 0}, {0, 1, 0});
  acquire::Light light;
  light.position = {0, 0.124747, 0.586889};
  light.falloff_exponent = 20;
  g.lights = {light};
  return g;
}

struct Noise {
  double relative = 0;    ///< 1 sigma of a pixel
  double angle_rad = 0;   ///< of the turntable, against the one read back
  double dusty = 0;       ///< share of the pixels that have lost 70 % of their light
};

struct Photographs {
  std::vector<PaintSample> samples;
  std::vector<PaintView> views;
};

/// Every pixel on its own: trace, illuminate, the paint's value; nothing of what is under test.
Photographs photographs(const acquire::RigGeometry& truth, const brdf::Brdf& paint, const Noise& noise, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  Calibration calibration;
  calibration.geometry = truth;
  Photographs p;
  const PaintBlocks blocks = paint_blocks(truth, 12);
  for (int view = 0; view < 12; ++view) {
    const double angle = 12 * view * degree;
    p.views.push_back({0, angle, 1});
    const acquire::PlacedLight light = truth.place_light(0, angle + noise.angle_rad * normal(random));
    RadianceImage image;
    image.width = truth.camera.width;
    image.height = truth.camera.height;
    const std::size_t n = static_cast<std::size_t>(image.width * image.height);
    image.radiance.assign(n, 0);
    image.variance.assign(n, 1);
    image.flags.assign(n, PixelFlag::valid);
    for (int y = 0; y < image.height; ++y)
      for (int x = 0; x < image.width; ++x) {
        const auto point = acquire::trace(truth, {x, y});
        const auto lit = point ? acquire::illuminate(light, *point) : std::nullopt;
        if (!lit) continue;
        const auto local = acquire::to_shading_frame(*point, lit->wi);
        const auto f = paint.value({local.wi, local.wo}, {});
        if (!f) continue;
        const double clean = 1e4 * f->y * lit->irradiance.y * (uniform(random) < noise.dusty ? 0.3 : 1.0);
        const auto i = static_cast<std::size_t>(y * image.width + x);
        image.radiance[i] = static_cast<float>(clean * (1 + noise.relative * normal(random)));
        image.variance[i] = static_cast<float>(std::pow(noise.relative * clean, 2));
      }
    add_paint_samples(image, calibration, static_cast<std::uint32_t>(view), blocks, p.samples);
  }
  return p;
}

std::shared_ptr<const brdf::Brdf> matte_paint() { return brdf::load_brdf(test::source_dir() / "data-samples/paints/blue-matte.json"); }

double chi2(const GeometryEvidence& e, const std::vector<double>& x) {
  double sum = 0;
  for (std::size_t k = 0; k < e.rows.size(); ++k) {
    double v = -e.offset[k];
    for (std::size_t i = 0; i < x.size(); ++i) v += e.rows[k][i] * x[i];
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
  double sum = 0, n = 0;
  for (unsigned seed = 1; seed <= seeds; ++seed) {
    const Photographs p = photographs(truth, *matte_paint(), noise, seed);
    const PaintEvidence e = paint_evidence(p.samples, p.views, unknowns, zero, options);
    EXPECT_GT(e.n_samples, 10000u);
    sum += chi2(e.geometry, zero);
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
