#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>

#include "libbrdf/files.h"
#include "libcalib/distant_lights.h"
#include "libcalib/highlights.h"
#include "libcalib/rendered_view.h"
#include "libcalib/sphere_outline.h"
#include "libcalib/sphere_photograph.h"
#include "test_support.h"

/// Hard cases of detection on photographs of the paper's rig (1360 x 1024, 12 bit, lens blur 0.7 px): windows about the highlight, rendered,
/// exposed and merged. bench_detection has the same with more seeds.
namespace lacquer::calib {
namespace {

using test::RenderedRig;
constexpr double degree = 3.14159265358979323846 / 180;

std::shared_ptr<const brdf::Brdf> paint(const std::string& name) {
  return std::make_shared<brdf::CookTorranceBrdf>(brdf::read_model(test::source_dir() / "data-samples/paints" / (name + ".json")));
}

std::shared_ptr<const brdf::Brdf> gloss(double kd, double ks, double m) {
  brdf::CookTorrance model;
  model.kd = glm::dvec3(kd);
  model.lobes = {{glm::dvec3(ks), m, 0.6}};
  return std::make_shared<brdf::CookTorranceBrdf>(model);
}

acquire::RigDescription paper_rig() { return acquire::read_rig(test::source_dir() / "rigs/simulated-paper.toml"); }

/// A window about the highlight at one angle.
struct Scene {
  std::unique_ptr<RenderedRig> rendered;
  acquire::sim::RadianceImage light;
  glm::dvec2 truth;
  double angle;
  std::vector<double> exposures_s;

  Scene(const acquire::RigDescription& whole, std::shared_ptr<const brdf::Brdf> painted, double angle_deg) : angle(angle_deg * degree) {
    const glm::dvec2 expected = *mirror_pixel(whole.geometry, whole.geometry.place_light(0, angle).position);
    constexpr int half = 50;
    const glm::ivec2 corner = 2 * (glm::ivec2(expected) / 2) - half;
    rendered = std::make_unique<RenderedRig>(test::windowed(whole, corner, glm::ivec2(2 * half)), std::move(painted));
    light = rendered->render(0, angle);
    truth = expected - glm::dvec2(corner);
    exposures_s = whole.plan.front().exposures_s;
  }
  HighlightResult find(std::uint64_t seed) const {
    return find_highlight(rendered->photograph(light, exposures_s, seed), rendered->calibration(), 0, angle, {});
  }
};

/// Mean error over a few seeds, and its pulls.
void expect_unbiased(const Scene& scene, double tolerance_px) {
  glm::dvec2 sum(0.0);
  double pulls = 0;
  constexpr int n = 5;
  for (std::uint64_t seed = 1; seed <= n; ++seed) {
    const auto found = scene.find(seed);
    ASSERT_EQ(found.fate, HighlightFate::found) << describe(found.fate);
    const glm::dvec2 d = found.highlight.pixel - scene.truth;
    sum += d;
    pulls += (d.x * d.x / found.highlight.xx + d.y * d.y / found.highlight.yy) / (2 * n);
  }
  EXPECT_LT(glm::length(sum) / n, tolerance_px);
  EXPECT_LT(std::sqrt(pulls), 2.0) << "the stated sigma is too small";
}

// 0.01 px here is a normal off by 0.0013 degrees in the middle of the sphere.
TEST(DetectionCases, CentroidsAreUnbiasedFromFrontToGrazing) {
  for (const double angle : {0.0, 60.0, 120.0}) {
    SCOPED_TRACE(angle);
    expect_unbiased(Scene(paper_rig(), paint("polaris-silber"), angle), 0.006);
  }
}

TEST(DetectionCases, ChromeNarrowerThanAPixelIsFound) {
  auto rig = paper_rig();
  rig.geometry.lights[0].intensity *= 3e-4;  // else it is clipped in every exposure
  for (const double m : {0.003, 0.002}) {
    SCOPED_TRACE(m);
    expect_unbiased(Scene(rig, gloss(1e-3, 1, m), 40), 0.006);
  }
}

TEST(DetectionCases, AMattePaintIsSaid) { EXPECT_EQ(Scene(paper_rig(), gloss(0.2, 0.05, 0.4), 40).find(1).fate, HighlightFate::matte); }

TEST(DetectionCases, AnOverexposedHighlightComesFromTheShorterExposures) {
  Scene scene(paper_rig(), paint("polaris-silber"), 40);
  const std::vector<double> all = scene.exposures_s;
  scene.exposures_s = {all[8], all[12], all[15]};
  EXPECT_EQ(scene.find(1).fate, HighlightFate::clipped) << "every exposure clips it";
  scene.exposures_s.insert(scene.exposures_s.begin(), all.front());
  expect_unbiased(scene, 0.01);
}

TEST(DetectionCases, ASphereFifteenDegreesOffTheOpticalAxis) {
  auto rig = paper_rig();
  const double t = 15 * degree;
  const glm::dmat3 turn(std::cos(t), 0, -std::sin(t), 0, 1, 0, std::sin(t), 0, std::cos(t));
  rig.geometry.cam_from_rig.rotation = turn * rig.geometry.cam_from_rig.rotation;
  rig.geometry.cam_from_rig.translation = turn * rig.geometry.cam_from_rig.translation;
  rig.geometry.camera.distortion = {};
  rig.geometry.camera.centre.x -= std::tan(t) * rig.geometry.camera.focal.x;
  expect_unbiased(Scene(rig, paint("polaris-silber"), 80), 0.006);
}

TEST(DetectionCases, AVeryShortFocalLength) {
  auto rig = paper_rig();
  rig.geometry.cam_from_rig = acquire::look_at({0, 0, 0.16}, {0, 0, 0}, {0, 1, 0});
  rig.geometry.camera.focal *= 0.15;
  rig.geometry.camera.distortion = {};
  expect_unbiased(Scene(rig, paint("polaris-silber"), 40), 0.006);
}

TEST(DetectionCases, ARivalIsNamedOrDoesNoHarm) {
  for (const double off_deg : {8.0, 3.0})
    for (const double share : {0.9, 0.1}) {
      Scene scene(paper_rig(), paint("polaris-silber"), 40);
      const auto other = scene.rendered->render(0, (40 + off_deg) * degree);
      for (std::size_t i = 0; i < scene.light.data.size(); ++i) scene.light.data[i] += static_cast<float>(share) * other.data[i];
      const auto found = scene.find(1);
      if (found.fate != HighlightFate::found) continue;
      const glm::dvec2 d = found.highlight.pixel - scene.truth;
      EXPECT_LT(std::abs(d.x), 0.02 + 3 * std::sqrt(found.highlight.xx)) << off_deg << " deg, " << share;
      EXPECT_LT(std::abs(d.y), 0.02 + 3 * std::sqrt(found.highlight.yy)) << off_deg << " deg, " << share;
    }
}

TEST(DetectionCases, DustBesideThePeakDoesNotMoveIt) {
  Scene scene(paper_rig(), paint("polaris-silber"), 40);
  for (int c = 0; c < scene.light.n_channels; ++c)
    for (int y = 0; y < scene.light.height; ++y)
      for (int x = 0; x < scene.light.width; ++x)
        if (glm::length(glm::dvec2(x, y) - scene.truth - glm::dvec2(6, 2)) < 1.5) scene.light.at(c, x, y) *= 0.1f;
  const auto found = scene.find(1);
  if (found.fate == HighlightFate::found) EXPECT_LT(glm::length(found.highlight.pixel - scene.truth), 0.1);
}

/// The sphere cut by the image's border: a third of the limb is outside.
TEST(DetectionCases, ASphereCutByTheBorderIsFoundFromTheRestOfItsLimb) {
  auto nominal = test::photographed_rig();
  nominal.camera.centre.x = 100;
  auto truth = nominal;
  const glm::dvec3 moved(0.002, 0.001, 0);
  truth.cam_from_rig.translation += truth.cam_from_rig.rotation * moved;
  for (auto& light : truth.lights) light.position -= moved;
  OutlineFinder finder(nominal, {.lens_blur_px = 0});
  for (const double angle : {-0.8, 0.0, 0.8}) finder.add(test::photograph(truth, angle, {.diffuse = 0.1}, 0.02, 6, 1), nominal.place_light(0, angle));
  const auto outline = finder.finish();
  EXPECT_LT(outline.edges.size(), 0.8 * static_cast<double>(outline.n_arcs)) << "part of it is outside";
  const auto c = outline.geometry.camera.project(outline.geometry.cam_from_rig.translation), d = truth.camera.project(truth.cam_from_rig.translation);
  EXPECT_LT(glm::length(*c - *d), 0.1);
}

TEST(DetectionCases, DirectionsOfDistantLightsAreThoseOfTheirHighlights) {
  auto truth = test::photographed_rig();
  truth.lights.clear();
  for (int k = 0; k < 8; ++k) {
    acquire::Light light;
    light.distant = true;
    light.on_arm = false;
    const double turn = 0.8 * k, tilt = 0.35 + 0.06 * k;
    light.direction = {std::sin(tilt) * std::cos(turn), std::sin(tilt) * std::sin(turn), std::cos(tilt)};
    truth.lights.push_back(light);
  }
  EXPECT_TRUE(all_lights_distant(truth));
  // The rig file has the sphere elsewhere, and all directions turned by 1 degree about the line of sight.
  auto nominal = truth;
  nominal.cam_from_rig.translation += glm::dvec3(0.001, -0.0005, 0.002);
  const double turn = 1 * degree;
  for (auto& light : nominal.lights)
    light.direction = {std::cos(turn) * light.direction.x - std::sin(turn) * light.direction.y, std::sin(turn) * light.direction.x + std::cos(turn) * light.direction.y, light.direction.z};
  std::vector<GeometryView> views;
  for (std::size_t k = 0; k < truth.lights.size(); ++k)
    views.push_back({"view " + std::to_string(k), k, 0, 1, [&truth, k] {
                       auto rig = truth;
                       std::swap(rig.lights[0], rig.lights[k]);  // photograph() lights with the first
                       return test::photograph(rig, 0, {.diffuse = 0.1, .m = 0.03}, 0.01, 3, static_cast<unsigned>(k));
                     }});
  Calibration calibration;
  calibration.geometry = nominal;
  const DistantLights found = find_distant_lights("test", nominal, views, calibration, {}, {});
  EXPECT_NEAR(found.median_off_rad / degree, std::sin(0.5) * 1.0, 0.3);
  for (std::size_t k = 0; k < truth.lights.size(); ++k) {
    ASSERT_EQ(found.lights[k].fate, HighlightFate::found) << k << ": " << describe(found.lights[k].fate);
    // A normal off by 0.1 px of 153 is 0.04 degrees, the direction off by twice that.
    EXPECT_LT(glm::length(found.lights[k].direction - truth.lights[k].direction) / degree, 0.08) << k;
    EXPECT_LT(glm::length(calibration.geometry.lights[k].direction - truth.lights[k].direction) / degree, 0.08) << k;
  }
  ASSERT_TRUE(found.joint.solved);
  EXPECT_NEAR(found.joint.turn.z / degree, -1, 0.05);
  EXPECT_LT(glm::length(found.joint.shift_px), 0.3);
  EXPECT_LT(found.joint.median_off_rad / degree, 0.05);
}

}  // namespace
}  // namespace lacquer::calib
