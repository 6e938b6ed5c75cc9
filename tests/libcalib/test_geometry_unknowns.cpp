#include "libcalib/geometry_unknowns.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>

#include "libcalib/geometry_projection.h"
#include "libcalib/quick_rig.h"

namespace lacquer::calib {
namespace {

std::size_t index_of(const GeometryUnknowns& unknowns, const std::string& name) {
  for (std::size_t k = 0; k < unknowns.size(); ++k)
    if (unknowns.parameters()[k].name == name) return k;
  throw std::out_of_range(name);
}

/// Some rig off the rig file, by the zero angle `zero` (of its prior) and by whatever place the light then has to have in the rig file.
std::vector<double> same_scene(const GeometryUnknowns& unknowns, const acquire::RigGeometry& nominal, double zero) {
  std::vector<double> x(unknowns.size());
  for (std::size_t k = 0; k < x.size(); ++k) x[k] = 0.1 + 0.03 * static_cast<double>(k);
  const std::size_t z = index_of(unknowns, "zero angle"), first = z + 2;
  x[z] = 0;
  const acquire::RigGeometry g = unknowns.geometry(x);
  const glm::dvec3 place = g.lights[0].position;
  const double angle = zero * unknowns.parameters()[z].prior_sigma;
  const glm::dvec3 before = g.axis_point + rotate(place - g.axis_point, g.axis_direction, -angle);
  const glm::dvec3 correction = before - (nominal.lights[0].position - glm::dvec3(x[0], x[1], x[2]) * 0.003);
  x[z] = zero;
  for (int k = 0; k < 3; ++k) x[first + static_cast<std::size_t>(k)] = correction[k] / unknowns.parameters()[first + static_cast<std::size_t>(k)].prior_sigma;
  return x;
}

TEST(GeometryUnknowns, WhatImagesSeeIsTheSameForAZeroAngleAndALightThatUndoEachOther) {
  const acquire::RigGeometry nominal = test::quick_rig(1);
  const GeometryUnknowns unknowns(nominal, {}, {true});
  const std::vector<double> a = same_scene(unknowns, nominal, 0), b = same_scene(unknowns, nominal, 0.8);
  const acquire::RigGeometry g = unknowns.geometry(a), h = unknowns.geometry(b);
  ASSERT_LT(glm::length(g.lights[0].position - h.lights[0].position), 1e-15);
  const std::vector<double> seen = unknowns.visible(g, a), other = unknowns.visible(h, b);
  for (std::size_t k = 0; k < seen.size(); ++k) EXPECT_NEAR(seen[k], other[k], 1e-12) << unknowns.parameters()[k].name;
}

TEST(GeometryUnknowns, AVisibleCoordinateMovesAloneAndByItsPriorsSigma) {
  const acquire::RigGeometry nominal = test::quick_rig(1);
  const GeometryUnknowns unknowns(nominal, {}, {true});
  const std::vector<double> x = same_scene(unknowns, nominal, 0.5);
  const std::vector<double> here = unknowns.visible(unknowns.geometry(x), x);
  for (const char* name : {"sphere.x", "axis.tilt_b", "step scale", "light 1.z"}) {
    const std::size_t k = index_of(unknowns, name);
    std::vector<double> moved_x = x;
    if (!unknowns.light_of(k)) moved_x[k] += 0.25;
    const std::vector<double> there = unknowns.visible(unknowns.with_visible_moved(x, k, 0.25), moved_x);
    for (std::size_t i = 0; i < here.size(); ++i) EXPECT_NEAR(there[i] - here[i], i == k ? 0.25 : 0, 1e-12) << name << " moved " << unknowns.parameters()[i].name;
  }
}

// Zero angle and place of a light turn the same light. However well images know where it is, the two priors share what they leave open.
TEST(GeometryUnknowns, StrongEvidenceOfALightsPlaceLeavesTheZeroAngleToThePriors) {
  const acquire::RigGeometry nominal = test::quick_rig(1);
  const GeometryPriors priors;
  const GeometryUnknowns unknowns(nominal, priors, {true});
  const std::size_t first = index_of(unknowns, "zero angle") + 2;
  GeometryEvidence evidence;
  evidence.views = {{0, 0}, {0, 0.5}};
  for (std::size_t k = 0; k < 3; ++k) {
    evidence.rows.emplace_back(unknowns.size());
    evidence.rows.back()[first + k] = 1e4;
    evidence.offset.push_back(1e4 * (k == 0 ? 3.0 : 0.5));  // far from the rig file, where the circle bends away from its tangent
  }
  const GeometryEstimate e = solve_geometry(nominal, {}, {}, priors, evidence);
  ASSERT_TRUE(e.converged);
  const glm::dvec3 place = e.geometry.lights[0].position;
  const double distance = std::hypot(place.x - e.geometry.axis_point.x, place.z - e.geometry.axis_point.z);
  const double by_light = std::hypot(priors.light_m, priors.sphere_m) / distance;  // images see the light from the sphere's centre
  const double together = 1 / std::hypot(1 / priors.zero_angle_rad, 1 / by_light);
  EXPECT_NEAR(e.uncertainty.parameters[index_of(unknowns, "zero angle")].sigma, together, 0.02 * together);
}

}  // namespace
}  // namespace lacquer::calib
