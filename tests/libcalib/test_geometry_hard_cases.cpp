#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <glm/geometric.hpp>
#include <iostream>

#include "libbrdf/files.h"
#include "libcalib/geometry_difference.h"
#include "libcalib/geometry_session.h"
#include "libcalib/rendered_view.h"
#include "test_support.h"

/// Hard cases through everything that `lacquer calibrate geometry` does: photographs of a rig that stands millimetres from where its file has
/// it, rendered, exposed, merged; silhouette, highlights and light on the paint; one LED, 240 x 180 pixels.
namespace lacquer::calib {
namespace {

constexpr double degree = 3.14159265358979323846 / 180;

acquire::RigDescription small_rig() {
  acquire::RigDescription rig = acquire::read_rig(test::source_dir() / "rigs/simulated-quick.toml");
  acquire::CameraModel& camera = rig.geometry.camera;
  camera.width /= 2;
  camera.height /= 2;
  camera.focal *= 0.5;
  camera.centre = 0.5 * (camera.centre + 0.5) - 0.5;
  return rig;
}

std::shared_ptr<const brdf::Brdf> paint(double kd, double ks, double m) {
  brdf::CookTorrance model;
  model.kd = glm::dvec3(kd);
  model.lobes = {{glm::dvec3(ks), m, 0.3}};
  return std::make_shared<brdf::CookTorranceBrdf>(model);
}

std::shared_ptr<const brdf::Brdf> polaris() {
  return std::make_shared<brdf::CookTorranceBrdf>(brdf::read_model(test::source_dir() / "data-samples/paints/polaris-silber.json"));
}

struct Case {
  acquire::RigDescription nominal = small_rig();
  std::shared_ptr<const brdf::Brdf> painted = polaris();
  double radius = 1;  ///< the rig file's over the true one
  std::vector<double> lens_covariance = {};
  std::function<void(acquire::CameraModel&)> lens = {};  ///< what is wrong with the rig file's
  std::function<void(acquire::sim::RadianceImage&)> scene = {};  ///< on the light before it reaches the sensor
  double last_angle_deg = 120, step_deg = 15;
};

struct Outcome {
  SessionGeometry found;
  GeometryDifference error;
  bool says(const std::string& text) const {
    return std::any_of(found.estimate.warnings.begin(), found.estimate.warnings.end(), [&](const std::string& w) { return w.find(text) != std::string::npos; });
  }
};

Outcome calibrate(const Case& c, bool use_paint = false) {
  acquire::RigDescription built = c.nominal;
  const glm::dvec3 sphere(0.002, -0.001, -0.001), light(0.004, -0.003, 0.005);
  built.geometry.cam_from_rig.translation += built.geometry.cam_from_rig.rotation * sphere;
  built.geometry.axis_point -= sphere;
  built.geometry.lights[0].position += light - sphere;
  if (c.lens) c.lens(built.geometry.camera);
  const test::RenderedRig rendered(built, c.painted);
  const auto& all = built.plan.front().exposures_s;
  std::vector<RadianceImage> images;
  std::vector<GeometryView> views;
  std::vector<ViewAngles> angles;
  for (double a = 0; a <= c.last_angle_deg; a += c.step_deg) {
    auto scene = rendered.render(0, a * degree);
    if (c.scene) c.scene(scene);
    images.push_back(rendered.photograph(scene, {all[0], all[2], all[4], all[6]}, images.size() + 1));
    angles.push_back({0, a * degree, a * degree});
  }
  for (std::size_t i = 0; i < images.size(); ++i) views.push_back({"L" + std::to_string(i), 0, angles[i].angle, 1, [&images, i] { return images[i]; }});
  acquire::RigGeometry nominal = c.nominal.geometry;
  nominal.sphere_radius *= c.radius;
  Calibration calibration = calibration_from_rig(c.nominal);
  calibration.lens_covariance = c.lens_covariance;
  GeometryOptions options;
  options.use_paint = use_paint;
  Outcome o{estimate_geometry("case", nominal, {}, views, calibration, options, {}), {}};
  for (std::size_t i = 0; i < angles.size(); ++i)
    angles[i].angle = calibration.turntable_scale * angles[i].angle + calibration.geometry_uncertainty.angle_correction(views[i].id);
  o.error = geometry_difference(calibration.geometry, built.geometry, angles);
  const GeometryEstimate& e = o.found.estimate;
  std::cout << "half vectors " << o.error.half_vector_rad / degree << " deg (stated " << e.half_vector_sigma_rad / degree << "), light " << o.error.light_rad / degree << " ("
            << e.light_sigma_rad / degree << "), distance " << 100 * o.error.distance << " % (" << 100 * e.distance_sigma << "), centre " << o.error.centre_px << " px ("
            << e.centre_sigma_px << "); " << e.n_edges << " of " << o.found.n_arcs << " arcs, " << e.n_highlights << " of " << o.found.n_views << " highlights, "
            << o.found.paint.n_samples << " samples\n";
  for (const std::string& w : e.warnings) std::cout << "  " << w << "\n";
  return o;
}

/// Within the error bars, and those no wider than `half_deg` and `centre_px`.
void expect_within_error_bars(const Outcome& o, double half_deg, double centre_px) {
  const GeometryEstimate& e = o.found.estimate;
  constexpr double many = 4;
  EXPECT_TRUE(e.converged);
  EXPECT_LT(o.error.half_vector_rad, many * e.half_vector_sigma_rad);
  EXPECT_LT(o.error.light_rad, many * e.light_sigma_rad);
  EXPECT_LT(o.error.distance, many * e.distance_sigma);
  EXPECT_LT(o.error.centre_px, many * e.centre_sigma_px);
  EXPECT_LT(e.half_vector_sigma_rad / degree, half_deg);
  EXPECT_LT(e.centre_sigma_px, centre_px);
}

/// At the rig file's geometry half vectors are off by 1 degree, the centre in the image by 3 px. The limb of 76 px and its light decide what is left;
/// the scatter of the few tiles says little of it, so the figures are held against fixed limits.
void expect_better_with_paint(Case c) {
  c.step_deg = 6;
  const Outcome o = calibrate(c, true);
  EXPECT_GT(o.found.paint.n_samples, 5000u);
  EXPECT_LT(o.error.half_vector_rad / degree, 0.1);
  EXPECT_LT(o.error.light_rad / degree, 0.1);
  EXPECT_LT(o.error.centre_px, 0.06);
}

TEST(GeometryCases, OneLightOnly) { expect_within_error_bars(calibrate({}), 0.12, 0.1); }

TEST(GeometryCases, ASphereFifteenDegreesOffTheOpticalAxis) {
  Case c;
  // The camera turns about itself; its principal point stays with the lens, the sphere leaves it.
  const double t = 15 * degree;
  const glm::dmat3 turn(std::cos(t), 0, -std::sin(t), 0, 1, 0, std::sin(t), 0, std::cos(t));
  acquire::RigGeometry& g = c.nominal.geometry;
  g.cam_from_rig.rotation = turn * g.cam_from_rig.rotation;
  g.cam_from_rig.translation = turn * g.cam_from_rig.translation;
  g.camera.distortion = {};
  g.camera.centre.x -= std::tan(t) * g.camera.focal.x;
  expect_within_error_bars(calibrate(c), 0.12, 0.1);
  expect_better_with_paint(c);
}

TEST(GeometryCases, AVeryShortFocalLength) {
  Case c;
  acquire::RigGeometry& g = c.nominal.geometry;
  g.cam_from_rig = acquire::look_at({0, 0, 0.16}, {0, 0, 0}, {0, 1, 0});
  g.camera.focal *= 0.15;
  g.camera.distortion = {};
  expect_within_error_bars(calibrate(c), 0.12, 0.1);
  expect_better_with_paint(c);
}

TEST(GeometryCases, ASphereCutByTheBorderOfTheImage) {
  Case c;
  c.nominal.geometry.camera.centre.x = 40;  // its radius is 76 px
  const Outcome o = calibrate(c);
  EXPECT_LT(o.found.estimate.n_edges, 45u);
  expect_within_error_bars(o, 0.15, 0.1);
}

TEST(GeometryCases, ADarkPaintBeforeADarkWallOnAStandWithAnArmAcross) {
  Case c;
  c.painted = paint(0.004, 0.03, 0.05);
  c.scene = [](acquire::sim::RadianceImage& image) {
    constexpr float wall = 2e-4f;
    for (int k = 0; k < image.n_channels; ++k)
      for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x) {
          float& v = image.at(k, x, y);
          if (x > 100 && x < 140 && y > 155) v = 20 * wall;       // the stand, before the lowest part of the limb
          else if (y > 40 && y < 52 && x > 150) v = 0.5f * wall;  // the arm, black, before the sphere
          else v += wall;                                         // the room's light, on wall and sphere alike
        }
  };
  expect_within_error_bars(calibrate(c), 0.15, 0.15);
}

TEST(GeometryCases, ALensWrongWithinItsCovariance) {
  Case c;
  c.lens_covariance = {4, 0, 0, 0, 0, 4, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};  // fx fy cx cy; the focal length is 1527 px
  c.lens = [](acquire::CameraModel& camera) {
    camera.focal += 2.0;
    camera.centre += glm::dvec2(1, -1.5);
  };
  const Outcome o = calibrate(c);
  EXPECT_EQ(std::count_if(o.found.estimate.uncertainty.parameters.begin(), o.found.estimate.uncertainty.parameters.end(),
                          [](const GeometryParameter& p) { return p.name.starts_with("lens."); }), 4);
  expect_within_error_bars(o, 0.15, 0.1);
}

TEST(GeometryCases, ARadiusWrongByAPercentIsSaid) {
  Case c;
  c.radius = 1.01;
  const Outcome o = calibrate(c, true);
  EXPECT_TRUE(o.says("its radius")) << "the sphere comes out 11 mm from where the ruler has it";
  EXPECT_LT(o.error.centre_px, 4 * o.found.estimate.centre_sigma_px) << "its place in the image does not depend on it";
}

}  // namespace
}  // namespace lacquer::calib
