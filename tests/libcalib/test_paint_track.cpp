#include "libcalib/paint_track.h"

#include <gtest/gtest.h>

#include <cmath>

#include "libcalib/geometry_projection.h"
#include "libcalib/quick_rig.h"

namespace lacquer::calib {
namespace {

constexpr double degree = 3.14159265358979323846 / 180;

TEST(PaintTrack, AHighlightSaysByHowMuchTheTurntableMissedItsAngle) {
  const acquire::RigGeometry rig = test::quick_rig(1);
  const GeometryUnknowns unknowns(rig, {}, {true});
  const double read_back = 40 * degree, missed = 0.003 * degree;
  const auto pixel = mirror_pixel(rig, rig.place_light(0, read_back + missed).position);
  ASSERT_TRUE(pixel);
  const auto track = paint_track(7, {"L000", 0, read_back, *pixel, 1e-4, 0, 1e-4}, 1, unknowns, std::vector<double>(unknowns.size()));
  ASSERT_TRUE(track);
  EXPECT_EQ(track->view, 7u);
  EXPECT_NEAR(track->angle, missed, 1e-4 * missed);
  EXPECT_GT(track->sigma, 0);
}

// A step scale that is wrong by e turns the light by e times the angle; a light that is moved along its way, by its move over its distance from the axis.
TEST(PaintTrack, WhatTheUnknownsExplainOfTheAngleIsAsByHand) {
  const acquire::RigGeometry rig = test::quick_rig(1);
  const GeometryPriors priors;
  const GeometryUnknowns unknowns(rig, priors, {true});
  const double angle = 40 * degree;
  const auto pixel = mirror_pixel(rig, rig.place_light(0, angle).position);
  ASSERT_TRUE(pixel);
  const auto track = paint_track(0, {"L000", 0, angle, *pixel, 1e-4, 0, 1e-4}, 1, unknowns, std::vector<double>(unknowns.size()));
  ASSERT_TRUE(track);
  for (std::size_t k = 0; k < unknowns.size(); ++k) {
    const std::string& name = unknowns.parameters()[k].name;
    if (name == "step scale") {
      EXPECT_NEAR(track->by[k], priors.turntable_scale * angle, 1e-6 * priors.turntable_scale * angle);
    }
    if (name == "zero angle") {
      EXPECT_EQ(track->by[k], 0) << "it is in the light's place";
    }
    if (name == "light 1.x") {
      EXPECT_NEAR(track->by[k], priors.light_m / rig.lights[0].position.z, 1e-6);
    }
  }
}

TEST(PaintTrack, ALightThatDoesNotTurnHasNone) {
  acquire::RigGeometry rig = test::quick_rig(1);
  rig.lights[0].on_arm = false;
  const GeometryUnknowns unknowns(rig, {}, {true});
  EXPECT_FALSE(paint_track(0, {"L000", 0, 0.5, {300, 180}, 1e-4, 0, 1e-4}, 1, unknowns, std::vector<double>(unknowns.size())));
}

}  // namespace
}  // namespace lacquer::calib
