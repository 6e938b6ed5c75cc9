#include "libcalib/geometry_solver.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "libbrdf/error.h"
#include "libcalib/geometry_accuracy.h"
#include "libcalib/geometry_residuals.h"
#include "libcalib/geometry_unknowns.h"
#include "libcalib/response_algebra.h"

namespace lacquer::calib {

namespace {

/// Levenberg-Marquardt (iteratively reweighted). True: it converged.
bool minimise(const GeometryResiduals& residuals, double cauchy, std::vector<double>& x) {
  std::vector<double> weight, trial_weight;
  std::vector<double> r = residuals.at(x);
  double cost = residuals.cost(r, cauchy, weight), damping = 1e-4;
  for (int iteration = 0; iteration < 200; ++iteration) {
    const std::vector<std::vector<double>> j = residuals.derivatives(x);
    const SymmetricMatrix a = normal_matrix(j, weight);
    std::vector<double> gradient(x.size());
    for (std::size_t k = 0; k < x.size(); ++k)
      for (std::size_t i = 0; i < r.size(); ++i) gradient[k] -= weight[i] * j[k][i] * r[i];
    for (;;) {
      SymmetricMatrix damped = a;
      for (std::size_t k = 0; k < x.size(); ++k) damped.at(k, k) *= 1 + damping;
      const std::vector<double> step = solve(damped, gradient);
      std::vector<double> next = x;
      double largest = 0;
      for (std::size_t k = 0; k < x.size(); ++k) {
        next[k] += step[k];
        largest = std::max(largest, std::abs(step[k]) * std::sqrt(a(k, k)));
      }
      const std::vector<double> next_r = residuals.at(next);
      const double next_cost = residuals.cost(next_r, cauchy, trial_weight);
      const bool better = next_cost < cost;
      if (better) {
        x = next;
        r = next_r;
        cost = next_cost;
        weight = trial_weight;
        damping = std::max(damping / 10, 1e-12);
      }
      if (largest < 1e-5) return true;  // of a sigma, were the other unknowns known
      if (better) break;
      damping *= 10;
      if (damping > 1e12) return true;  // no step is better: rounding
    }
  }
  return false;
}

/// Residuals of what was used, and outliers by name.
void describe_fit(const GeometryResiduals& residuals, const std::vector<double>& x, GeometryEstimate& e) {
  e.edge_noise_factor = residuals.edge_factor();
  e.highlight_noise_factor = residuals.highlight_factor();
  e.angle_sigma_rad = residuals.angle_sigma();
  double edge_sum = 0, highlight_sum = 0;
  for (std::size_t i = 0; i < residuals.edges().size(); ++i) {
    if (!residuals.edge_used()[i]) {
      ++e.n_edge_outliers;
      continue;
    }
    ++e.n_edges;
    const double d = silhouette_distance(e.geometry, residuals.edges()[i].pixel).value_or(0) - residuals.unknowns().edge_offset(x, residuals.side(i));
    edge_sum += d * d;
  }
  for (std::size_t i = 0; i < residuals.highlights().size(); ++i) {
    const Highlight& h = residuals.highlights()[i];
    const glm::dvec2 d = GeometryResiduals::miss(e.geometry, e.turntable_scale, h);
    if (residuals.highlight_used()[i]) {
      if (residuals.angle_sigma() > 0) e.uncertainty.angles.push_back(residuals.angle_of(e.geometry, e.turntable_scale, i));
      ++e.n_highlights;
      highlight_sum += glm::dot(d, d);
    } else {
      e.outliers.push_back({h.view, h.light, d});
    }
  }
  if (e.n_edges > 0) e.edge_rms_px = std::sqrt(edge_sum / static_cast<double>(e.n_edges));
  if (e.n_highlights > 0) e.highlight_rms_px = std::sqrt(highlight_sum / (2 * static_cast<double>(e.n_highlights)));
}

/// Larger axis of the error of the sphere's centre in the image.
double centre_sigma_px(const GeometryUnknowns& unknowns, const std::vector<double>& x, const SymmetricMatrix& covariance) {
  constexpr double step = 1e-3;
  std::vector<glm::dvec2> by(x.size());
  for (std::size_t k = 0; k < x.size(); ++k) {
    std::vector<double> up = x, down = x;
    up[k] += step;
    down[k] -= step;
    const acquire::RigGeometry a = unknowns.geometry(up), b = unknowns.geometry(down);
    const auto p = a.camera.project(a.cam_from_rig.translation), q = b.camera.project(b.cam_from_rig.translation);
    if (p && q) by[k] = (*p - *q) / (2 * step);
  }
  double xx = 0, xy = 0, yy = 0;
  for (std::size_t k = 0; k < x.size(); ++k)
    for (std::size_t l = 0; l < x.size(); ++l) {
      xx += by[k].x * covariance(k, l) * by[l].x;
      xy += by[k].x * covariance(k, l) * by[l].y;
      yy += by[k].y * covariance(k, l) * by[l].y;
    }
  return std::sqrt(std::max(0.0, 0.5 * (xx + yy) + std::hypot(0.5 * (xx - yy), xy)));
}

/// Covariance of the unknowns and what it means for samples.
void add_uncertainty(const GeometryResiduals& residuals, const acquire::RigGeometry& nominal, const std::vector<double>& x, GeometryEstimate& e) {
  const auto j = residuals.derivatives(x);
  std::vector<double> weight(j.front().size(), 1.0);
  const SymmetricMatrix information = normal_matrix(j, weight);
  std::fill(weight.end() - static_cast<std::ptrdiff_t>(x.size()), weight.end(), 0.0);  // the priors
  const SymmetricMatrix from_images = normal_matrix(j, weight);
  const SymmetricMatrix inverse = sandwich(information, information);
  const std::size_t n = x.size();
  std::vector<double> scaled(n * n);
  e.uncertainty.parameters = residuals.unknowns().parameters();
  e.uncertainty.covariance.resize(n * n);
  for (std::size_t a = 0; a < n; ++a) {
    GeometryParameter& p = e.uncertainty.parameters[a];
    p.correction = x[a] * p.prior_sigma;
    p.sigma = std::sqrt(inverse(a, a)) * p.prior_sigma;
    for (std::size_t b = 0; b < n; ++b) {
      scaled[a * n + b] = inverse(a, b);
      e.uncertainty.covariance[a * n + b] = inverse(a, b) * p.prior_sigma * residuals.unknowns().parameters()[b].prior_sigma;
    }
  }
  e.centre_sigma_px = centre_sigma_px(residuals.unknowns(), x, inverse);
  const GeometryEffects effects = geometry_effects(residuals, x);
  e.light_sigma_rad = rms_effect(effects.light, scaled, 3);
  e.half_vector_sigma_rad = rms_effect(effects.half, scaled, 3);
  e.distance_sigma = rms_effect(effects.distance, scaled, 1);
  e.warnings = geometry_warnings(residuals, nominal, x, information, from_images, effects);
}

void check_input(const acquire::RigGeometry& g, const std::vector<EdgePoint>& edges, const std::vector<Highlight>& highlights, const GeometryEvidence& evidence) {
  if (g.camera.projection != acquire::CameraModel::Projection::pinhole)
    throw Error(ErrorCode::input, "camera: orthographic; geometry can be estimated for a pinhole camera only, keep the rig file's (--from-rig)");
  if (edges.empty() && highlights.empty() && evidence.rows.empty()) throw Error(ErrorCode::input, "geometry: neither silhouette nor highlights, expected at least one of them");
  for (const EdgePoint& e : edges)
    if (!(e.sigma > 0) || !std::isfinite(e.pixel.x + e.pixel.y + e.sigma)) throw Error(ErrorCode::input, "geometry: edge point: expected finite numbers, sigma > 0");
  for (const GeometryEvidence::View& view : evidence.views)
    if (view.light >= g.lights.size() || g.lights[view.light].distant)
      throw Error(ErrorCode::input, fmt::format("light {}: expected a near light of the rig; only near lights can be estimated, keep the rig file's (--from-rig)", view.light + 1));
  for (const Highlight& h : highlights) {
    if (h.light >= g.lights.size()) throw Error(ErrorCode::input, fmt::format("view {}: light: expected an index below {}", h.view, g.lights.size()));
    if (g.lights[h.light].distant)
      throw Error(ErrorCode::input, fmt::format("view {}: light {} is distant; only near lights can be estimated, keep the rig file's (--from-rig)", h.view, h.light + 1));
    if (!(h.xx > 0 && h.xx * h.yy > h.xy * h.xy) || !std::isfinite(h.pixel.x + h.pixel.y + h.xx + h.yy))
      throw Error(ErrorCode::input, fmt::format("view {}: highlight: expected finite numbers and a positive covariance", h.view));
  }
}

}  // namespace

void GeometryPriors::validate() const {
  for (const double s : {sphere_m, axis_point_m, axis_tilt_rad, zero_angle_rad, turntable_scale, light_m, arm, edge_offset_px, edge_side_px})
    if (!(s > 0 && std::isfinite(s))) throw Error(ErrorCode::usage, "geometry priors: expected numbers > 0");
  const std::size_t n = n_intrinsics();
  bool good = lens_covariance.empty() || (n >= 4 && n <= 12 && n * n == lens_covariance.size());
  for (std::size_t i = 0; good && i < n; ++i)
    for (std::size_t j = 0; j < n; ++j) good = good && std::isfinite(lens_covariance[i * n + j]) && lens_covariance[i * n + i] >= 0;
  if (!good) throw Error(ErrorCode::usage, "geometry priors: lens_covariance: expected a covariance of 4 to 12 intrinsics");
}

std::size_t GeometryPriors::n_intrinsics() const { return static_cast<std::size_t>(std::llround(std::sqrt(static_cast<double>(lens_covariance.size())))); }

std::vector<bool> lights_with_data(const acquire::RigGeometry& nominal, const std::vector<Highlight>& highlights, const GeometryEvidence& evidence) {
  std::vector<bool> seen(nominal.lights.size());
  for (const GeometryEvidence::View& view : evidence.views) seen[view.light] = true;
  for (const Highlight& h : highlights) seen[h.light] = true;
  return seen;
}

GeometryEstimate solve_geometry(const acquire::RigGeometry& nominal, const std::vector<EdgePoint>& edges, const std::vector<Highlight>& highlights,
                                const GeometryPriors& priors, const GeometryEvidence& evidence, const std::vector<double>& start) {
  priors.validate();
  check_input(nominal, edges, highlights, evidence);
  const GeometryUnknowns unknowns(nominal, priors, lights_with_data(nominal, highlights, evidence));
  GeometryResiduals residuals(unknowns, edges, highlights, evidence);
  std::vector<double> x = start;
  if (x.size() != unknowns.size()) {
    x.assign(unknowns.size(), 0.0);
    minimise(residuals, 3, x);
  }
  GeometryEstimate e;
  constexpr int max_rounds = 12;
  for (int round = 0; round < max_rounds; ++round) {
    const auto before = std::pair(residuals.edge_used(), residuals.highlight_used());
    const double edge = residuals.edge_factor(), highlight = residuals.highlight_factor(), angle = residuals.angle_sigma();
    residuals.measure_noise(x);
    residuals.select_inliers(x);
    e.converged = minimise(residuals, 0, x);
    const auto same = [](double a, double b) { return std::abs(a - b) <= 0.01 * b; };
    if (before == std::pair(residuals.edge_used(), residuals.highlight_used()) && same(edge, residuals.edge_factor()) && same(highlight, residuals.highlight_factor()) &&
        same(angle, residuals.angle_sigma()))
      break;
  }
  e.geometry = unknowns.geometry(x);
  e.turntable_scale = unknowns.turntable_scale(x);
  describe_fit(residuals, x, e);
  add_uncertainty(residuals, nominal, x, e);
  return e;
}

}  // namespace lacquer::calib
