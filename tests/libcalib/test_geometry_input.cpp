#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>

#include "libbrdf/error.h"
#include "libcalib/geometry_projection.h"
#include "libcalib/geometry_unknowns.h"
#include "libcalib/quick_rig.h"

/// What the geometry's solver does with data that are wrong.
namespace lacquer::calib {
namespace {

constexpr double degree = 3.14159265358979323846 / 180;

// What highlights say along their tracks may be in the evidence instead of their residuals; one that is false along its track is found all the same.
TEST(GeometrySolver, AHighlightFalseAlongItsTrackIsLeftOutBesideEvidence) {
  const acquire::RigGeometry rig = test::quick_rig(1);
  std::vector<EdgePoint> edges;
  const glm::dvec2 centre = *rig.camera.project(rig.cam_from_rig.translation);
  for (int k = 0; k < 90; ++k) {
    const glm::dvec2 out(std::cos(4 * degree * k), std::sin(4 * degree * k));
    double radius = 153;
    for (int i = 0; i < 20; ++i) radius -= *silhouette_distance(rig, centre + radius * out);
    edges.push_back({centre + radius * out, 0.05});
  }
  std::vector<Highlight> highlights;
  for (int a = 0; a <= 120; a += 5)
    if (const auto pixel = mirror_pixel(rig, rig.place_light(0, a * degree).position)) highlights.push_back({std::to_string(a), 0, a * degree, *pixel, 1e-4, 0, 1e-4});
  ASSERT_GT(highlights.size(), 15u);
  const glm::dvec2 track = highlights[8].pixel - highlights[6].pixel;
  highlights[7].pixel += 3.0 * glm::normalize(track);
  GeometryEvidence evidence;
  evidence.has_tracks = true;
  const GeometryUnknowns unknowns(rig, {}, {true});
  evidence.views = {{0, 0}};
  evidence.rows.assign(1, std::vector<double>(unknowns.size()));
  evidence.rows[0].back() = 1;
  evidence.offset = {0};
  const GeometryEstimate e = solve_geometry(rig, edges, highlights, {}, evidence);
  ASSERT_EQ(e.outliers.size(), 1u);
  EXPECT_EQ(e.outliers[0].view, highlights[7].view);
}

TEST(GeometrySolver, BadInputIsRefused) {
  auto rig = test::quick_rig();
  EXPECT_THROW(solve_geometry(rig, {}, {}), Error);
  EXPECT_THROW(solve_geometry(rig, {{{100, 100}, 0}}, {}), Error) << "sigma 0";
  EXPECT_THROW(solve_geometry(rig, {}, {{"L0", 3, 0, {200, 100}}}), Error) << "no such light";
  EXPECT_THROW(solve_geometry(rig, {}, {{"L0", 0, 0, {NAN, 100}}}), Error);
  EXPECT_THROW(solve_geometry(rig, {}, {{"L0", 0, 0, {200, 100}, 1, 2, 1}}), Error) << "no covariance";
  rig.lights[0].distant = true;
  EXPECT_THROW(solve_geometry(rig, {}, {{"L0", 0, 0, {200, 100}}}), Error);
  rig = test::quick_rig();
  rig.camera.projection = acquire::CameraModel::Projection::orthographic;
  EXPECT_THROW(solve_geometry(rig, {{{100, 100}, 0.1}}, {}), Error);
}

}  // namespace
}  // namespace lacquer::calib
