#include "libcalib/geometry_difference.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <optional>
#include <utility>

namespace lacquer::calib {

namespace {

constexpr double min_cosine = 0.0872;  // 85 degrees

using Points = std::pair<acquire::SurfacePoint, acquire::SurfacePoint>;

/// What a grid of pixels sees with either geometry.
std::vector<Points> seen_points(const acquire::RigGeometry& g, const acquire::RigGeometry& truth, int grid) {
  std::vector<Points> points;
  const int step = std::max(1, g.camera.height / grid);
  for (int y = 0; y < g.camera.height; y += step)
    for (int x = 0; x < g.camera.width; x += step) {
      const auto p = acquire::trace(g, {x, y}), q = acquire::trace(truth, {x, y});
      if (p && q && glm::dot(q->normal, q->wo) >= min_cosine) points.emplace_back(*p, *q);
    }
  return points;
}

glm::dvec3 half_against_normal(const acquire::SurfacePoint& point, const glm::dvec3& wi) { return glm::normalize(wi + point.wo) - point.normal; }

}  // namespace

GeometryDifference geometry_difference(const acquire::RigGeometry& g, const acquire::RigGeometry& truth, const std::vector<ViewAngles>& views, int grid) {
  const std::vector<Points> points = seen_points(g, truth, grid);
  double half = 0, light = 0, distance = 0;
  std::size_t n = 0, n_views = 0;
  for (const ViewAngles& view : views) {
    if (g.lights[view.light].distant) continue;
    const glm::dvec3 l = g.place_light(view.light, view.angle).position, m = truth.place_light(view.light, view.true_angle).position;
    const glm::dvec3 turn = glm::normalize(l) - glm::normalize(m);
    light += glm::dot(turn, turn);
    distance += std::pow(glm::length(l) / glm::length(m) - 1, 2);
    ++n_views;
    for (const auto& [p, q] : points) {
      const glm::dvec3 true_wi = glm::normalize(m - q.position);
      if (glm::dot(true_wi, q.normal) < min_cosine) continue;
      const glm::dvec3 d = half_against_normal(p, glm::normalize(l - p.position)) - half_against_normal(q, true_wi);
      half += glm::dot(d, d);
      ++n;
    }
  }
  GeometryDifference difference;
  if (n > 0) difference.half_vector_rad = std::sqrt(half / static_cast<double>(n));
  if (n_views > 0) {
    difference.light_rad = std::sqrt(light / static_cast<double>(n_views));
    difference.distance = std::sqrt(distance / static_cast<double>(n_views));
  }
  const auto c = g.camera.project(g.cam_from_rig.translation), d = truth.camera.project(truth.cam_from_rig.translation);
  if (c && d) difference.centre_px = glm::length(*c - *d);
  return difference;
}

}  // namespace lacquer::calib
