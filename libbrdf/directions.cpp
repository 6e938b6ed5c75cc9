#include "libbrdf/directions.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>

namespace lacquer::brdf {

namespace {
constexpr double pi = std::numbers::pi;
}

HalfDiff half_diff(const Directions& d) {
  const glm::dvec3 sum = d.wi + d.wo;
  const glm::dvec3 difference = d.wi - d.wo;
  const double sum_length = glm::length(sum);
  if (sum_length < 1e-300) return {0.0, pi / 2, 0.0};

  // atan2 forms keep full relative accuracy where acos has none (h = n, wi = wo, opposite directions).
  const double sin_h = std::hypot(sum.x, sum.y);
  HalfDiff c;
  c.theta_h = std::atan2(sin_h, sum.z);
  c.theta_d = std::atan2(glm::length(difference), sum_length);

  // Frame at h: e_theta points away from the normal, e_phi = h x e_theta. At h = n the azimuth of h is taken as 0.
  const double cos_phi = sin_h > 0 ? sum.x / sin_h : 1.0;
  const double sin_phi = sin_h > 0 ? sum.y / sin_h : 0.0;
  const double cos_h = sum.z / sum_length;
  const double sin_hn = sin_h / sum_length;
  const double along_theta = (difference.x * cos_phi + difference.y * sin_phi) * cos_h - difference.z * sin_hn;
  // + 0.0 turns a negative zero into 0: atan2(-0, negative) would be -pi, outside the range.
  const double along_phi = -difference.x * sin_phi + difference.y * cos_phi + 0.0;
  c.phi_d = (along_theta == 0 && along_phi == 0) ? 0.0 : std::atan2(along_phi, along_theta);
  return c;
}

Directions directions(const HalfDiff& c) {
  const double sh = std::sin(c.theta_h), ch = std::cos(c.theta_h);
  const double sd = std::sin(c.theta_d), cd = std::cos(c.theta_d);
  const double x = sd * std::cos(c.phi_d), y = sd * std::sin(c.phi_d);
  // h = (sh, 0, ch), e_theta = (ch, 0, -sh), e_phi = (0, 1, 0)
  const glm::dvec3 h(sh * cd, 0.0, ch * cd), t(x * ch, y, -x * sh);
  return {h + t, h - t};
}

HalfAngleCosines<double> half_angle_cosines(const Directions& d) {
  const glm::dvec3 sum = d.wi + d.wo;
  const double length = glm::length(sum);
  HalfAngleCosines<double> c;
  c.n_dot_i = d.wi.z;
  c.n_dot_o = d.wo.z;
  c.n_dot_h = length > 0 ? sum.z / length : 1.0;
  c.i_dot_h = std::min(length / 2, 1.0);  // rounding of wi = wo; Schlick's weight must not become negative
  c.tan2_theta_h = length > 0 ? (sum.x * sum.x + sum.y * sum.y) / (sum.z * sum.z) : 0.0;
  return c;
}

HalfAngleCosines<double> half_angle_cosines(const HalfDiff& c) {
  const double sh = std::sin(c.theta_h), ch = std::cos(c.theta_h);
  const double sd = std::sin(c.theta_d), cd = std::cos(c.theta_d);
  const double t = sh * sd * std::cos(c.phi_d);
  const double tan_h = sh / ch;
  return {ch * cd - t, ch * cd + t, ch, cd, tan_h * tan_h};
}

double fold_phi_d(double phi_d) {
  double folded = std::fmod(phi_d, pi);
  if (folded < 0) folded += pi;
  return folded >= pi ? 0.0 : folded;  // rounding may land exactly on pi
}

glm::dvec3 direction(double theta, double phi) {
  return {std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta)};
}

}  // namespace lacquer::brdf
