#include "libcalib/geometry_unknowns.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "libcalib/geometry_projection.h"
#include "libcalib/response_algebra.h"

namespace lacquer::calib {

namespace {

double& intrinsic(acquire::CameraModel& camera, std::size_t k) {
  return k < 2 ? camera.focal[static_cast<int>(k)] : k < 4 ? camera.centre[static_cast<int>(k - 2)] : camera.distortion[k - 4];
}

}  // namespace

GeometryUnknowns::GeometryUnknowns(const acquire::RigGeometry& nominal, const GeometryPriors& priors, const std::vector<bool>& seen)
    : nominal_(nominal), priors_(priors), seen_(seen) {
  const glm::dvec3 axis = glm::normalize(nominal.axis_direction);
  const glm::dvec3 helper = std::abs(axis.x) < 0.9 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 0, 1);
  across_[0] = glm::normalize(helper - axis * glm::dot(helper, axis));
  across_[1] = glm::cross(across_[0], axis);
  const char* const letters[] = {"x", "y", "z"};
  for (int k = 0; k < 3; ++k) add(fmt::format("sphere.{}", letters[k]), "m", 0, priors.sphere_m);
  add("edge offset", "px", 0, priors.edge_offset_px);
  for (const char* letter : {"x", "y"}) add(fmt::format("edge offset.{}", letter), "px", 0, priors.edge_side_px);
  if (std::none_of(seen_.begin(), seen_.end(), [](bool s) { return s; })) return;
  add_lens();
  first_axis_ = parameters_.size();
  add("axis.tilt_a", "rad", 0, priors.axis_tilt_rad);
  add("axis.tilt_b", "rad", 0, priors.axis_tilt_rad);
  add("axis.a", "m", glm::dot(nominal.axis_point, across_[0]), priors.axis_point_m);
  add("axis.b", "m", glm::dot(nominal.axis_point, across_[1]), priors.axis_point_m);
  add("zero angle", "rad", 0, priors.zero_angle_rad);
  add("step scale", "1", 1, priors.turntable_scale);
  for (std::size_t i = 0; i < seen_.size(); ++i) {
    first_light_.push_back(parameters_.size());
    if (!seen_[i]) continue;
    const acquire::Light& light = nominal.lights[i];
    const std::string name = light.name.empty() ? fmt::format("light {}", i + 1) : fmt::format("light {}", light.name);
    for (int k = 0; k < 3; ++k) {
      const double along = priors.arm * light.position[k];
      add(fmt::format("{}.{}", name, letters[k]), "m", light.position[k], std::hypot(priors.light_m, along));
    }
  }
}

void GeometryUnknowns::add_lens() {
  constexpr std::array names{"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"};
  const std::size_t all = priors_.n_intrinsics();
  const std::vector<double>& c = priors_.lens_covariance;
  first_lens_ = parameters_.size();
  for (std::size_t k = 0; k < all; ++k) {
    if (!(c[k * all + k] > 0)) continue;
    lens_.push_back(k);
    add(fmt::format("lens.{}", names[k]), k < 4 ? "px" : "1", intrinsic(nominal_.camera, k), std::sqrt(c[k * all + k]));
  }
  const std::size_t n = lens_.size();
  std::vector<double> correlation(n * n);
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j)
      correlation[i * n + j] = c[lens_[i] * all + lens_[j]] / (parameters_[first_lens_ + i].prior_sigma * parameters_[first_lens_ + j].prior_sigma);
  lens_factor_ = cholesky_factor(correlation, n);
}

std::optional<std::size_t> GeometryUnknowns::light_of(std::size_t k) const {
  for (std::size_t i = 0; i < first_light_.size(); ++i)
    if (seen_[i] && k >= first_light_[i] && k < first_light_[i] + 3) return i;
  return std::nullopt;
}

acquire::RigGeometry GeometryUnknowns::geometry(const std::vector<double>& x) const {
  acquire::RigGeometry g = nominal_;
  for (std::size_t k = 0; k < lens_.size(); ++k) intrinsic(g.camera, lens_[k]) += value(x, first_lens_ + k);
  const glm::dvec3 sphere(value(x, 0), value(x, 1), value(x, 2));
  g.cam_from_rig.translation += g.cam_from_rig.rotation * sphere;
  g.axis_point -= sphere;
  if (!has_lights()) {
    for (acquire::Light& light : g.lights) light.position -= sphere;
    return g;
  }
  g.axis_direction = rotate(rotate(g.axis_direction, across_[0], value(x, first_axis_)), across_[1], value(x, first_axis_ + 1));
  g.axis_point += value(x, first_axis_ + 2) * across_[0] + value(x, first_axis_ + 3) * across_[1];
  const double zero = value(x, first_axis_ + 4);
  for (std::size_t i = 0; i < g.lights.size(); ++i) {
    acquire::Light& light = g.lights[i];
    if (light.distant) continue;
    light.position -= sphere;
    if (seen_[i])
      for (int k = 0; k < 3; ++k) light.position[k] += value(x, first_light_[i] + static_cast<std::size_t>(k));
    if (light.on_arm) light.position = g.axis_point + rotate(light.position - g.axis_point, g.axis_direction, zero);
  }
  return g;
}

std::vector<double> GeometryUnknowns::visible(const acquire::RigGeometry& g, const std::vector<double>& x) const {
  std::vector<double> v = x;
  if (has_lights()) v[first_axis_ + 4] = 0;
  for (std::size_t i = 0; i < first_light_.size(); ++i)
    for (std::size_t k = 0; k < 3 && seen_[i]; ++k) v[first_light_[i] + k] = (g.lights[i].position - nominal_.lights[i].position)[static_cast<int>(k)] / parameters_[first_light_[i] + k].prior_sigma;
  return v;
}

acquire::RigGeometry GeometryUnknowns::with_visible_moved(const std::vector<double>& x, std::size_t k, double step) const {
  acquire::RigGeometry g = geometry(x);
  if (const auto light = light_of(k)) {
    g.lights[*light].position[static_cast<int>(k - first_light_[*light])] += step * parameters_[k].prior_sigma;
    return g;
  }
  std::vector<double> moved = x;
  moved[k] += step;
  std::vector<acquire::Light> held = std::move(g.lights);
  g = geometry(moved);
  g.lights = std::move(held);
  return g;
}

void GeometryUnknowns::prior_residuals(const std::vector<double>& x, std::vector<double>& out) const {
  std::size_t n_plain = first_light_.empty() ? size() : first_light_.front();
  std::vector<double> white = x;
  const std::size_t n_lens = lens_.size();
  constexpr double least = 1e-6;  // of an intrinsic that the others determine
  for (std::size_t i = 0; i < n_lens; ++i) {
    double& r = white[first_lens_ + i];
    for (std::size_t k = 0; k < i; ++k) r -= lens_factor_[i * n_lens + k] * white[first_lens_ + k];
    r /= std::max(least, lens_factor_[i * n_lens + i]);
  }
  for (std::size_t i = 0; i < n_plain; ++i) out.push_back(white[i]);
  for (std::size_t i = 0; i < first_light_.size(); ++i) {
    if (!seen_[i]) continue;
    const glm::dvec3& p = nominal_.lights[i].position;
    const double length = glm::length(p);
    const glm::dvec3 u = p / length;
    const glm::dvec3 d(value(x, first_light_[i]), value(x, first_light_[i] + 1), value(x, first_light_[i] + 2));
    const double along = glm::dot(d, u);
    const glm::dvec3 ruled = (d - along * u) / priors_.light_m + u * (along / std::hypot(priors_.light_m, priors_.arm * length));
    for (int k = 0; k < 3; ++k) out.push_back(ruled[k]);
  }
}

}  // namespace lacquer::calib
