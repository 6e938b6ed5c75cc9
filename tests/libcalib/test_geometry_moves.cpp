#include "libcalib/geometry_moves.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <glm/geometric.hpp>

#include "libcalib/geometry_unknowns.h"

namespace lacquer::calib {
namespace {

acquire::Session session() {
  acquire::Session s;
  acquire::RigGeometry& g = s.rig.geometry;
  g.camera.width = g.camera.height = 200;
  g.camera.focal = {1200, 1200};
  g.camera.centre = {99.5, 99.5};
  g.cam_from_rig = acquire::look_at({0, 0, 1}, {0, 0, 0}, {0, 1, 0});
  g.sphere_radius = 0.05;
  acquire::Light light;
  light.name = "LED";
  light.on_arm = false;
  light.position = {0.4, 0, 0.3};  // half a metre away
  g.lights = {light};
  for (int i = 0; i < 5; ++i) s.views.push_back({.id = "L00" + std::to_string(i), .turntable_angle = 0.2 * i});
  return s;
}

/// A calibration whose corrections are 0.3 of their priors' sigmas, known to `covariance` of the light's place alone.
Calibration calibration(const acquire::Session& s, const std::array<double, 9>& covariance) {
  const GeometryUnknowns unknowns(s.rig.geometry, {}, {true});
  Calibration c;
  const std::size_t n = unknowns.size();
  c.geometry = unknowns.geometry(std::vector<double>(n, 0.3));
  c.turntable_scale = unknowns.turntable_scale(std::vector<double>(n, 0.3));
  c.geometry_uncertainty.parameters = unknowns.parameters();
  for (GeometryParameter& p : c.geometry_uncertainty.parameters) p.correction = 0.3 * p.prior_sigma;
  c.geometry_uncertainty.covariance.assign(n * n, 0.0);
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j) c.geometry_uncertainty.covariance[(n - 3 + i) * n + n - 3 + j] = covariance[3 * i + j];
  return c;
}

TEST(GeometryMoves, TheirOuterProductsAreTheCovariance) {
  const acquire::Session s = session();
  const std::array<double, 9> covariance{4e-6, 1e-6, -1e-6, 1e-6, 2e-6, 5e-7, -1e-6, 5e-7, 3e-6};
  const Calibration c = calibration(s, covariance);
  const auto moved = moved_calibrations(s, c);
  ASSERT_TRUE(moved);
  ASSERT_EQ(moved->size(), 3u) << "nothing else is uncertain";
  std::array<double, 9> sum{};
  for (const Calibration& m : *moved) {
    const glm::dvec3 d = m.geometry.lights[0].position - c.geometry.lights[0].position;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) sum[static_cast<std::size_t>(3 * i + j)] += d[i] * d[j];
  }
  for (std::size_t k = 0; k < 9; ++k) EXPECT_NEAR(sum[k], covariance[k], 1e-12) << k;
}

TEST(GeometryMoves, DistanceAndHalfVectorsByHand) {
  const acquire::Session s = session();
  // 1 mm along z alone: the light is at about (0.4, 0, 0.3), so 0.6 mm of 0.5 m in distance and 0.8 mm across, of which half vectors see half.
  const Calibration c = calibration(s, {0, 0, 0, 0, 0, 0, 0, 0, 1e-6});
  const auto moved = moved_calibrations(s, c);
  ASSERT_TRUE(moved);
  ASSERT_EQ(moved->size(), 1u);
  const GeometrySigma sigma = geometry_sigma(s, c, *moved);
  EXPECT_NEAR(sigma.distance, 0.6e-3 / 0.5, 0.05 * 1.2e-3);
  EXPECT_NEAR(sigma.half_vector_rad, 0.8e-3 / 0.5 / 2, 0.3 * 0.8e-3);  // points of the sphere are up to 10 % nearer, cos(theta_d) below 1 adds
}

TEST(GeometryMoves, NothingIsKnownOfAGeometryThatWasNotEstimatedOrIsAnother) {
  const acquire::Session s = session();
  Calibration c = calibration(s, {1e-6, 0, 0, 0, 1e-6, 0, 0, 0, 1e-6});
  EXPECT_TRUE(moved_calibrations(s, c));
  c.geometry.lights[0].position.x += 1e-3;
  EXPECT_FALSE(moved_calibrations(s, c));
  EXPECT_FALSE(moved_calibrations(s, Calibration{}));
}

}  // namespace
}  // namespace lacquer::calib
