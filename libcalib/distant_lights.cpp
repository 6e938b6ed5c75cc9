#include "libcalib/distant_lights.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat2x2.hpp>
#include <optional>

#include "libbrdf/error.h"
#include "libcalib/geometry_projection.h"
#include "libcalib/response_algebra.h"

namespace lacquer::calib {

namespace {

constexpr double pi = 3.14159265358979323846;

double angle_between(const glm::dvec3& a, const glm::dvec3& b) { return std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b)); }

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// The line of sight mirrored at the sphere.
std::optional<glm::dvec3> mirrored(const acquire::RigGeometry& rig, const glm::dvec2& pixel) {
  const auto point = acquire::trace(rig, pixel);
  if (!point) return std::nullopt;
  return 2 * glm::dot(point->normal, point->wo) * point->normal - point->wo;
}

/// Larger axis of the direction's covariance.
double direction_sigma(const acquire::RigGeometry& rig, const Highlight& h) {
  constexpr double step = 0.05;
  glm::dvec3 by[2];
  for (int k = 0; k < 2; ++k) {
    const glm::dvec2 d(k == 0 ? step : 0, k == 0 ? 0 : step);
    const auto up = mirrored(rig, h.pixel + d), down = mirrored(rig, h.pixel - d);
    if (!up || !down) return 0;
    by[k] = (*up - *down) / (2 * step);
  }
  // Trace and determinant of J C J^T in the plane across the direction.
  const double aa = glm::dot(by[0], by[0]), ab = glm::dot(by[0], by[1]), bb = glm::dot(by[1], by[1]);
  const double trace = h.xx * aa + 2 * h.xy * ab + h.yy * bb, determinant = (h.xx * h.yy - h.xy * h.xy) * (aa * bb - ab * ab);
  return std::sqrt(trace / 2 + std::sqrt(std::max(0.0, trace * trace / 4 - determinant)));
}

/// Mean radius of the outline about the image of the centre.
double outline_radius(const acquire::RigGeometry& rig, const glm::dvec2& centre) {
  const double start = rig.camera.focal.x * std::tan(std::asin(rig.sphere_radius / glm::length(rig.cam_from_rig.translation)));
  constexpr int n = 64;
  double sum = 0;
  for (int i = 0; i < n; ++i) {
    const glm::dvec2 outwards(std::cos(2 * pi * i / n), std::sin(2 * pi * i / n));
    double radius = start;
    for (int k = 0; k < 10; ++k) radius -= silhouette_distance(rig, centre + radius * outwards).value_or(0);
    sum += radius;
  }
  return sum / n;
}

constexpr std::size_t n_unknowns = 6;  // turn about x, y, z; shift x, y and growth of the outline, pixels
using Unknowns = std::array<double, n_unknowns>;

/// The rig with the outline elsewhere. `radius_px`: of the outline.
acquire::RigGeometry with_outline(acquire::RigGeometry rig, const Unknowns& x, double radius_px) {
  glm::dvec3& t = rig.cam_from_rig.translation;
  t.x += x[3] * t.z / rig.camera.focal.x;
  t.y += x[4] * t.z / rig.camera.focal.y;
  t *= radius_px / (radius_px + x[5]);
  return rig;
}

glm::dvec3 turned(const glm::dvec3& d, const Unknowns& x) {
  const glm::dvec3 turn(x[0], x[1], x[2]);
  const double angle = glm::length(turn);
  return angle > 0 ? rotate(d, turn / angle, angle) : d;
}

/// Differences of directions across the given one, two for each highlight.
std::vector<double> differences(const acquire::RigGeometry& rig, const std::vector<const DistantLight*>& found, const Unknowns& x, double radius_px) {
  const acquire::RigGeometry moved = with_outline(rig, x, radius_px);
  std::vector<double> r;
  for (const DistantLight* light : found) {
    const glm::dvec3& d = light->given;
    const glm::dvec3 u = glm::normalize(glm::cross(std::abs(d.y) < 0.9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0), d)), v = glm::cross(d, u);
    const glm::dvec3 off = mirrored(moved, light->pixel).value_or(d) - turned(d, x);
    r.push_back(glm::dot(off, u));
    r.push_back(glm::dot(off, v));
  }
  return r;
}

JointDirections joint_directions(const acquire::RigGeometry& rig, const std::vector<DistantLight>& lights, double radius_px) {
  std::vector<const DistantLight*> found;
  for (const DistantLight& light : lights)
    if (light.fate == HighlightFate::found) found.push_back(&light);
  JointDirections joint;
  if (found.size() < n_unknowns) return joint;
  Unknowns x{};
  constexpr std::array<double, n_unknowns> step{1e-4, 1e-4, 1e-4, 0.01, 0.01, 0.01};
  SymmetricMatrix covariance;
  for (int iteration = 0; iteration < 20; ++iteration) {
    const std::vector<double> r = differences(rig, found, x, radius_px);
    std::vector<std::vector<double>> by(n_unknowns);
    for (std::size_t k = 0; k < n_unknowns; ++k) {
      Unknowns up = x, down = x;
      up[k] += step[k];
      down[k] -= step[k];
      by[k] = differences(rig, found, up, radius_px);
      const std::vector<double> below = differences(rig, found, down, radius_px);
      for (std::size_t i = 0; i < r.size(); ++i) by[k][i] = (by[k][i] - below[i]) / (2 * step[k]);
    }
    std::vector<double> size;
    for (const double value : r) size.push_back(std::abs(value));
    const double scale = std::max(1e-9, 2 * 1.4826 * median(size));
    SymmetricMatrix a(n_unknowns), spread(n_unknowns);
    std::vector<double> b(n_unknowns);
    for (std::size_t i = 0; i < r.size(); ++i) {
      const double weight = 1 / (1 + r[i] * r[i] / (scale * scale));
      for (std::size_t p = 0; p < n_unknowns; ++p) {
        b[p] -= weight * by[p][i] * r[i];
        for (std::size_t q = 0; q <= p; ++q) {
          a.at(p, q) += weight * by[p][i] * by[q][i];
          spread.at(p, q) += weight * weight * r[i] * r[i] * by[p][i] * by[q][i];
        }
      }
    }
    const std::vector<double> change = solve(a, b);
    for (std::size_t k = 0; k < n_unknowns; ++k) x[k] += change[k];
    covariance = sandwich(a, spread);
  }
  const auto sigma = [&](std::size_t k) { return std::sqrt(std::max(0.0, covariance(k, k))); };
  joint = {{x[0], x[1], x[2]}, {sigma(0), sigma(1), sigma(2)}, {x[3], x[4]}, {sigma(3), sigma(4)}, x[5], sigma(5), 0, true};
  const acquire::RigGeometry moved = with_outline(rig, x, radius_px);
  std::vector<double> off;
  for (const DistantLight* light : found)
    off.push_back(angle_between(mirrored(moved, light->pixel).value_or(light->given), turned(light->given, x)));
  joint.median_off_rad = median(off);
  return joint;
}

}  // namespace

bool all_lights_distant(const acquire::RigGeometry& rig) {
  return !rig.lights.empty() && std::all_of(rig.lights.begin(), rig.lights.end(), [](const acquire::Light& light) { return light.distant; });
}

DistantLights find_distant_lights(const std::string& name, const acquire::RigGeometry& nominal, const std::vector<GeometryView>& views,
                                  Calibration& calibration, const HighlightOptions& options, const Progress& progress) {
  OutlineFinder finder(nominal, {.lens_blur_px = calibration.lens_blur_px});
  for (std::size_t i = 0; i < views.size(); ++i) {
    finder.add(views[i].read(), nominal.place_light(views[i].light, views[i].turntable_angle));
    if (progress) progress("silhouette", i + 1, views.size());
  }
  const OutlineFinder::Outline outline = finder.finish();
  if (outline.edges.empty())
    throw Error(ErrorCode::input, fmt::format("{}: no silhouette in {} views: expected a lit sphere before a darker background; or keep the rig file's geometry (--from-rig)",
                                              name, views.size()));
  DistantLights result;
  result.n_arcs = outline.n_arcs;
  if (!(calibration.lens_blur_px > 0)) calibration.lens_blur_px = outline.lens_blur_px;
  // Size and distance are one unknown here: nobody has measured them with a ruler.
  GeometryPriors priors;
  priors.sphere_m = 2 * nominal.sphere_radius;
  result.sphere = solve_geometry(nominal, outline.edges, {}, priors);
  Calibration trial = calibration;
  trial.geometry = result.sphere.geometry;
  trial.turntable_scale = 1;
  result.centre_px = trial.geometry.camera.project(trial.geometry.cam_from_rig.translation).value_or(glm::dvec2(0.0));
  result.radius_px = outline_radius(trial.geometry, result.centre_px);

  std::vector<double> off;
  std::vector<glm::dvec3> sum(nominal.lights.size(), glm::dvec3(0.0));
  for (std::size_t i = 0; i < views.size(); ++i) {
    const GeometryView& view = views[i];
    const HighlightResult found = find_highlight(view.read(), trial, view.light, view.turntable_angle, options);
    DistantLight light;
    light.view = view.id;
    light.light = view.light;
    light.fate = found.fate;
    light.given = nominal.place_light(view.light, view.turntable_angle).direction;
    const auto direction = found.fate == HighlightFate::found ? mirrored(trial.geometry, found.highlight.pixel) : std::nullopt;
    if (direction) {
      light.pixel = found.highlight.pixel;
      light.direction = *direction;
      light.sigma_rad = direction_sigma(trial.geometry, found.highlight);
      light.off_rad = angle_between(light.direction, light.given);
      off.push_back(light.off_rad);
      const bool turns = nominal.lights[view.light].on_arm;
      sum[view.light] += turns ? rotate(light.direction, nominal.axis_direction, -view.turntable_angle) : light.direction;
    }
    result.lights.push_back(light);
    if (progress) progress("highlights", i + 1, views.size());
  }
  if (off.empty())
    throw Error(ErrorCode::input, fmt::format("{}: no highlight in any of {} views: the lights cannot be found with this sphere; keep the rig file's geometry (--from-rig)",
                                              name, views.size()));
  result.median_off_rad = median(off);
  result.largest_off_rad = *std::max_element(off.begin(), off.end());
  result.joint = joint_directions(trial.geometry, result.lights, result.radius_px);

  calibration.geometry = trial.geometry;
  calibration.turntable_scale = 1;
  calibration.geometry_uncertainty = {};
  for (std::size_t k = 0; k < sum.size(); ++k)
    if (glm::length(sum[k]) > 0) calibration.geometry.lights[k].direction = glm::normalize(sum[k]);
  calibration.geometry_source = "directions of distant lights from highlights, sphere from its silhouette";
  return result;
}

}  // namespace lacquer::calib
