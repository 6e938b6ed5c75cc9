#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <glm/geometric.hpp>
#include <limits>
#include <numbers>

#include "libacquire/open_rig.h"
#include "libacquire/sim/simulated_world.h"
#include "libbrdf/error.h"

namespace lacquer::acquire {
namespace {

constexpr double pi = std::numbers::pi;

std::shared_ptr<const brdf::Brdf> lambertian(double albedo) {
  return std::make_shared<brdf::CookTorranceBrdf>(brdf::CookTorrance{.kd = glm::dvec3(albedo), .lobes = {}});
}

/// Narrow gloss on black.
std::shared_ptr<const brdf::Brdf> glossy() {
  return std::make_shared<brdf::CookTorranceBrdf>(brdf::CookTorrance{.kd = glm::dvec3(0), .lobes = {{glm::dvec3(0.05), 0.03, 0.5}}});
}

/// 161 x 121 pixels, sphere of 50 pixels radius seen from 1 m, one light of 2 W/sr at 0.55 m in front; photon noise negligible.
RigDescription description() {
  RigDescription d;
  RigGeometry& g = d.geometry;
  g.sphere_radius = 0.05;
  g.camera.width = 161;
  g.camera.height = 121;
  g.camera.focal = {1000, 1000};
  g.camera.centre = {80, 60};
  g.cam_from_rig = look_at({0, 0, 1}, {0, 0, 0}, {0, 1, 0});
  Light light;
  light.position = {0, 0, 0.55};
  light.intensity = glm::dvec3(2);
  g.lights = {light};
  d.sensor.bits = 16;
  d.sensor.black_level_dn = 200;
  d.sensor.gain_e_per_dn = 1e5;
  d.sensor.sensitivity = glm::dvec3(1e10);
  return d;
}

RawFrame photograph(const RigDescription& d, std::shared_ptr<const brdf::Brdf> paint, double angle = 0, double exposure = 0.05, int light = 0) {
  Rig rig = open_simulated_rig(d, std::move(paint));
  rig.turntable->move_to(angle);
  rig.lights->on(light);
  return rig.camera->capture({exposure, 0});
}

double value_at(const RawFrame& frame, int x, int y) { return frame.data[static_cast<std::size_t>(y * frame.width + x)]; }

double mean_of(const RawFrame& frame) {
  double total = 0;
  for (const auto v : frame.data) total += v;
  return total / static_cast<double>(frame.data.size());
}

/// Centroid of the counts above black.
glm::dvec2 centroid(const RawFrame& frame, double black) {
  glm::dvec2 moment(0.0);
  double total = 0;
  for (int y = 0; y < frame.height; ++y)
    for (int x = 0; x < frame.width; ++x) {
      const double v = value_at(frame, x, y) - black;
      moment += v * glm::dvec2(x, y);
      total += v;
    }
  return moment / total;
}

// ---- counts

TEST(SimulatedRig, CountsOfALambertianSphereAreWhatTheFormulaSays) {
  const RawFrame frame = photograph(description(), lambertian(0.6));
  // Nearest point: E = I / d^2 with d = 0.5 m; L = rho / pi E; DN = black + L sensitivity t / gain.
  const double radiance = 0.6 / pi * 2 / 0.25;
  EXPECT_NEAR(value_at(frame, 80, 60), 200 + radiance * 1e10 * 0.05 / 1e5, 3);  // pixel mean of a sphere of 50 pixels: 1e-4 less
  EXPECT_EQ(frame.actual.exposure_s, 0.05);
  EXPECT_EQ(frame.bits, 16);
}

TEST(SimulatedRig, CountsFallWithTheSquareOfTheLightsDistance) {
  RigDescription d = description();
  Light far = d.geometry.lights[0];
  far.position.z = 1.05;
  d.geometry.lights.push_back(far);
  const RawFrame near_frame = photograph(d, lambertian(0.6)), far_frame = photograph(d, lambertian(0.6), 0, 0.05, 1);
  EXPECT_NEAR((value_at(near_frame, 80, 60) - 200) / (value_at(far_frame, 80, 60) - 200), 4, 0.01);
}

TEST(SimulatedRig, CountsAreProportionalToTheExposure) {
  Rig rig = open_simulated_rig(description(), lambertian(0.6));
  rig.lights->on(0);
  const RawFrame one = rig.camera->capture({0.01, 0}), eight = rig.camera->capture({0.08, 0});
  EXPECT_NEAR((value_at(eight, 80, 60) - 200) / (value_at(one, 80, 60) - 200), 8, 0.03);
}

TEST(SimulatedRig, WithoutLightThereIsBlackAndDarkCurrent) {
  RigDescription d = description();
  d.sensor.gain_e_per_dn = 1;
  d.sensor.dark_current_e_per_s = 1000;
  Rig rig = open_simulated_rig(d, lambertian(0.6));
  EXPECT_NEAR(mean_of(rig.camera->capture({0.5, 0})), 700, 1);  // nothing switched on yet
  rig.lights->on(0);
  EXPECT_GT(mean_of(rig.camera->capture({0.5, 0})), 1000);
  rig.lights->off();
  EXPECT_NEAR(mean_of(rig.camera->capture({0.5, 0})), 700, 1);
}

TEST(SimulatedRig, MosaicPixelsSeeTheirOwnChannelOfThePaint) {
  RigDescription d = description();
  d.sensor.layout = PixelLayout::bayer_grbg;
  const auto paint = std::make_shared<brdf::CookTorranceBrdf>(brdf::CookTorrance{.kd = {0.1, 0.2, 0.4}, .lobes = {}});
  const RawFrame frame = photograph(d, paint);
  const double green = value_at(frame, 80, 60) - 200, red = value_at(frame, 81, 60) - 200, blue = value_at(frame, 80, 61) - 200;
  EXPECT_NEAR(green / red, 2, 0.01);  // neighbours on the sphere differ by 1e-3
  EXPECT_NEAR(blue / green, 2, 0.01);
}

// ---- imperfections

TEST(SimulatedRig, ADisplacedSphereMovesInThePicture) {
  RigDescription d = description();
  const glm::dvec2 nominal = centroid(photograph(d, lambertian(0.6)), 200);
  d.simulation.sphere_offset = {0.004, 0.002, 0};
  const glm::dvec2 moved = centroid(photograph(d, lambertian(0.6)), 200);
  // 1000 px / 1 m; the lit cap is 0.05 m nearer and 4 mm from the light's axis, both a few per cent. Up in the rig is down in y.
  EXPECT_NEAR(moved.x - nominal.x, 4, 0.25);
  EXPECT_NEAR(moved.y - nominal.y, -2, 0.15);
}

/// Orthographic camera and distant light, where the highlight lies exactly at the half vector.
RigDescription distant_description() {
  RigDescription d = description();
  d.geometry.camera.projection = CameraModel::Projection::orthographic;
  d.geometry.lights[0].distant = true;
  d.sensor.sensitivity = glm::dvec3(1e9);
  return d;
}

glm::dvec2 highlight_of_light_from(const glm::dvec3& direction) {
  const glm::dvec3 n = glm::normalize(glm::normalize(direction) + glm::dvec3(0, 0, 1));
  return glm::dvec2(80, 60) + 50.0 * glm::dvec2(n.x, -n.y);
}

TEST(SimulatedRig, TheTurntableTurnsTheLightRightHanded) {
  const double angle = 1.0;  // about y, from z towards x
  const glm::dvec2 seen = centroid(photograph(distant_description(), glossy(), angle), 200);
  EXPECT_LT(glm::length(seen - highlight_of_light_from({std::sin(angle), 0, std::cos(angle)})), 0.15);  // skew of the lobe
}

TEST(SimulatedRig, ATiltedAxisMovesTheHighlightOutOfTheEquator) {
  RigDescription d = distant_description();
  const glm::dvec2 straight = centroid(photograph(d, glossy(), pi / 2), 200);
  d.simulation.axis_tilt_x = 0.05;
  const glm::dvec2 tilted = centroid(photograph(d, glossy(), pi / 2), 200);
  // Axis a = (0, cos t, sin t): z turned by 90 degrees about it is a sin t + a x z = (cos t, sin t cos t, sin^2 t), by hand.
  const glm::dvec3 wi(std::cos(0.05), std::sin(0.05) * std::cos(0.05), std::sin(0.05) * std::sin(0.05));
  EXPECT_LT(glm::length(tilted - straight - (highlight_of_light_from(wi) - highlight_of_light_from({1, 0, 0}))), 0.05);
  EXPECT_LT(tilted.y, straight.y - 1);  // up in the picture
}

TEST(SimulatedRig, AnAxisOffCentreChangesTheLightsDistance) {
  RigDescription d = description();
  d.simulation.axis_offset = {0, 0, 0.05};
  const RawFrame front = photograph(d, lambertian(0.6), 0), back_of_turn = photograph(d, lambertian(0.6), 2 * pi);
  EXPECT_NEAR(mean_of(front), mean_of(back_of_turn), 0.01);  // a full turn leads back
  // Half a turn about an axis at z = 0.05 brings the light from z = 0.55 to -0.45: nothing lit is seen.
  const sim::SimulatedWorld world(d, lambertian(0.6));
  EXPECT_NEAR(world.geometry().place_light(0, pi).position.z, -0.45, 1e-12);
}

TEST(SimulatedRig, StepAndReadbackErrorsHaveTheirRmsAndStayTheSameForAnAngle) {
  RigDescription d = description();
  d.simulation.step_error_rms = 2e-3;
  d.simulation.readback_noise_rms = 1e-3;
  sim::SimulatedWorld world(d, lambertian(0.6));
  double step = 0, readback = 0;
  constexpr int n = 4000;
  for (int i = 0; i < n; ++i) {
    const double angle = 0.001 * i, read = world.move_to(angle);
    step += std::pow(world.true_angle() - angle, 2) / n;
    readback += std::pow(read - angle, 2) / n;
  }
  EXPECT_NEAR(std::sqrt(step) / 2e-3, 1, 4 / std::sqrt(2.0 * n));
  EXPECT_NEAR(std::sqrt(readback) / 1e-3, 1, 4 / std::sqrt(2.0 * n));
  const double first = world.move_to(0.7), true_first = world.true_angle();
  world.move_to(0.1);
  EXPECT_EQ(world.move_to(0.7), first);
  EXPECT_EQ(world.true_angle(), true_first);
}

TEST(SimulatedRig, LedsFadeExponentiallyWhileTheyWarmUp) {
  RigDescription d = description();
  d.simulation.led_drift_per_hour = 0.1;
  d.sensor.sensitivity = glm::dvec3(1e6);
  sim::SimulatedWorld world(d, lambertian(0.6));
  EXPECT_NEAR(world.led_factor(0), 1, 1e-15);
  EXPECT_NEAR((1 - world.led_factor(1.0)) / (0.1 / 3600), 1, 1e-3);  // slope at the start: 10 % per hour
  EXPECT_NEAR(world.led_factor(3600), 1 - 0.1 * (1 - 1 / std::numbers::e), 1e-12);
  world.switch_light(0);
  const RawFrame early = world.photograph({10, 0});
  world.photograph({7200, 0});
  const RawFrame late = world.photograph({10, 0});
  EXPECT_NEAR((value_at(late, 80, 60) - 200) / (value_at(early, 80, 60) - 200), 1 - 0.1 * (1 - std::exp(-2.0)), 2e-3);  // 400 DN
}

TEST(SimulatedRig, LedNoiseScalesWholeFrames) {
  RigDescription d = description();
  d.simulation.led_noise_rms = 0.02;
  sim::SimulatedWorld world(d, lambertian(0.6));
  world.switch_light(0);
  double mean = 0, square = 0;
  constexpr int n = 100;
  for (int i = 0; i < n; ++i) {
    const double v = value_at(world.photograph({0.05, 0}), 80, 60) - 200;
    mean += v / n;
    square += v * v / n;
  }
  EXPECT_NEAR(std::sqrt(square - mean * mean) / mean / 0.02, 1, 4 / std::sqrt(2.0 * n));
}

// ---- repeatability

RigDescription imperfect() {
  RigDescription d = description();
  d.sensor.layout = PixelLayout::bayer_rggb;
  d.sensor.bits = 12;
  d.sensor.gain_e_per_dn = 2;
  d.sensor.read_noise_e = 5;
  d.sensor.dark_current_e_per_s = 10;
  d.sensor.sensitivity = {1e4, 2e4, 1.5e4};
  d.sensor.vignetting = 0.2;
  d.simulation = {.paint = {}, .seed = 5, .axis_tilt_x = 0.01, .axis_tilt_z = -0.01, .axis_offset = {0.001, 0, 0}, .step_error_rms = 1e-3,
                  .readback_noise_rms = 1e-3, .led_drift_per_hour = 0.5, .led_noise_rms = 0.01, .stray_light = 0.01, .blur_px = 0.7,
                  .sphere_offset = {0, 0.001, 0}};
  d.plan = {{0.0, 0, {0.01, 0.05}, {}}, {0.4, 0, {0.01, 30.0}, {}}, {0.8, 0, {0.01, 0.05}, {}}};
  return d;
}

std::vector<RawFrame> run_views(const RigDescription& d, std::size_t first) {
  Rig rig = open_simulated_rig(d, glossy());
  std::vector<RawFrame> frames;
  for (std::size_t i = first; i < d.plan.size(); ++i) {
    rig.lights->off();
    rig.turntable->move_to(d.plan[i].turntable_angle);
    rig.lights->on(d.plan[i].light);
    for (const double exposure : d.plan[i].exposures_s) frames.push_back(rig.camera->capture({exposure, 0}));
  }
  return frames;
}

TEST(SimulatedRig, SameSeedGivesTheSameBytesForAnyNumberOfThreads) {
  const auto parallel = run_views(imperfect(), 0);
  const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
  const auto serial = run_views(imperfect(), 0);
  for (std::size_t i = 0; i < parallel.size(); ++i) EXPECT_EQ(parallel[i].data, serial[i].data) << i;
}

TEST(SimulatedRig, AResumedSessionPhotographsTheSameFrames) {
  const auto all = run_views(imperfect(), 0), rest = run_views(imperfect(), 2);
  ASSERT_EQ(rest.size(), 2u);
  EXPECT_EQ(rest[0].data, all[4].data);
  EXPECT_EQ(rest[1].data, all[5].data);
}

TEST(SimulatedRig, OtherSeedsAndRepeatedFramesHaveOtherNoiseOnTheSamePicture) {
  RigDescription d = imperfect();
  d.simulation.step_error_rms = d.simulation.led_noise_rms = 0;
  const RawFrame first = photograph(d, glossy());
  d.simulation.seed = 6;
  const RawFrame other = photograph(d, glossy());
  EXPECT_NE(first.data, other.data);
  EXPECT_NEAR(mean_of(first), mean_of(other), 0.2);  // noise of 2.6 DN over 19000 pixels: 0.02
  Rig rig = open_simulated_rig(d, glossy());
  rig.lights->on(0);
  const RawFrame again = rig.camera->capture({0.05, 0}), repeated = rig.camera->capture({0.05, 0});
  EXPECT_NE(again.data, repeated.data);
}

// ---- wrong input

void expect_refused(const std::string& part, const std::function<void(RigDescription&)>& spoil) {
  RigDescription d = description();
  spoil(d);
  try {
    open_simulated_rig(d, lambertian(0.5));
    ADD_FAILURE() << "accepted a wrong " << part;
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find(part), std::string::npos) << e.what();
  }
}

TEST(SimulatedRig, RefusesDescriptionsThatCannotBeBuilt) {
  EXPECT_THROW(open_simulated_rig(description(), nullptr), Error);
  expect_refused("camera size", [](RigDescription& d) { d.geometry.camera.width = 0; });
  expect_refused("lights", [](RigDescription& d) { d.geometry.lights.clear(); });
  expect_refused("position", [](RigDescription& d) { d.geometry.lights[0].position = {0, 0, 0.01}; });
  expect_refused("bits", [](RigDescription& d) { d.sensor.bits = 20; });
  expect_refused("gain", [](RigDescription& d) { d.sensor.gain_e_per_dn = 0; });
  expect_refused("blur", [](RigDescription& d) { d.simulation.blur_px = std::numeric_limits<double>::quiet_NaN(); });
  expect_refused("no pixel", [](RigDescription& d) { d.geometry.cam_from_rig = look_at({0, 0, 1}, {0, 1, 0}, {0, 1, 0}); });
}

}  // namespace
}  // namespace lacquer::acquire
