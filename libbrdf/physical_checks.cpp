#include "libbrdf/physical_checks.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>
#include <optional>
#include <unordered_map>

#include "libbrdf/error.h"

namespace lacquer::brdf {

namespace {

constexpr double pi = std::numbers::pi;

double median(std::vector<double>& values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

Asymmetry asymmetry(std::vector<double>& logs) {
  Asymmetry a;
  a.n = logs.size();
  if (logs.empty()) return a;
  for (const double x : logs) a.mean_abs_log += x / static_cast<double>(logs.size());
  a.median_abs_log = median(logs);
  const auto p95 = logs.begin() + static_cast<std::ptrdiff_t>(0.95 * static_cast<double>(logs.size() - 1));
  std::nth_element(logs.begin(), p95, logs.end());
  a.p95_abs_log = *p95;
  return a;
}

void add_logs(const glm::dvec3& a, const glm::dvec3& b, std::vector<double>& logs) {
  for (int c = 0; c < 3; ++c)
    if (a[c] > 0 && b[c] > 0) logs.push_back(std::abs(std::log(a[c] / b[c])));
}

/// Integral over half vectors; `weights`: of each table cell's value in it, per channel alike.
struct Integral {
  glm::dvec3 value{0.0};
  double cosine = 0, undefined = 0;  // of the hemisphere, cosine-weighted
  std::unordered_map<std::size_t, double> weights;
};

Integral integrate(const Brdf& brdf, double theta_i, int n, bool with_weights) {
  Integral sum;
  const glm::dvec3 wi = direction(theta_i, 0);
  const int n_phi = 2 * n;
  for (int i = 0; i < n; ++i) {
    const double u = (i + 0.5) / n, theta_h = u * u * pi / 2, width = pi * u / n;  // dtheta_h = pi u du
    for (int j = 0; j < n_phi; ++j) {
      const glm::dvec3 h = direction(theta_h, (j + 0.5) * 2 * pi / n_phi);
      const double i_dot_h = glm::dot(wi, h);
      const glm::dvec3 wo = 2 * i_dot_h * h - wi;
      if (!(i_dot_h > 0 && wo.z > 0)) continue;
      const double w = wo.z * 4 * i_dot_h * std::sin(theta_h) * width * 2 * pi / n_phi;
      sum.cosine += w;
      const Directions d{wi, wo};
      const auto f = brdf.value(d);
      if (!f) {
        sum.undefined += w;
        continue;
      }
      sum.value += w * *f;
      if (with_weights) sum.weights[TableGrid::index(half_diff(d))] += w;
    }
  }
  return sum;
}

Reflectance reflectance(const Brdf& brdf, double theta_i, int resolution) {
  const auto* table = dynamic_cast<const TableBrdf*>(&brdf);
  const Integral fine = integrate(brdf, theta_i, resolution, table != nullptr), coarse = integrate(brdf, theta_i, resolution / 2, false);
  Reflectance r;
  r.theta_i = theta_i;
  r.value = fine.value;
  r.undefined = fine.cosine > 0 ? fine.undefined / fine.cosine : 0;
  for (int c = 0; c < 3; ++c) {
    double variance = std::pow((fine.value[c] - coarse.value[c]) / 3, 2);  // the midpoint rule's error falls by four from coarse to fine
    if (table) {
      const auto& channels = table->table().channels;
      const TableChannel& t = channels[channels.size() == 3 ? static_cast<std::size_t>(c) : 0];
      for (const auto& [cell, w] : fine.weights) variance += w * w * t.variance[cell];
      variance += std::pow(table->table().scale_sigma * fine.value[c], 2);
    }
    r.sigma[c] = std::sqrt(variance);
  }
  return r;
}

double relative_variance(const TableChannel& t, std::size_t i) { return double{t.variance[i]} / (double{t.mean[i]} * double{t.mean[i]}); }

/// Measured, and five sigma above zero.
bool clear(const TableChannel& t, std::size_t i) { return t.origin[i] == CellOrigin::measured && t.mean[i] > 0 && relative_variance(t, i) < 1.0 / 25; }

/// Of ln f over (theta_h, theta_d, phi_d), from the two neighbours along each axis where their samples really were.
struct LogGradient {
  glm::dvec3 slope, variance;
};
std::optional<LogGradient> log_gradient(const TableChannel& t, std::size_t i) {
  const TableGrid::Cell c = TableGrid::cell(i);
  if (c.theta_h == 0 || c.theta_h == TableGrid::n_theta_h - 1 || c.theta_d == 0 || c.theta_d == TableGrid::n_theta_d - 1) return {};
  LogGradient g;
  const std::vector<float>* const coordinates[3] = {&t.theta_h, &t.theta_d, &t.phi_d};
  for (int axis = 0; axis < 3; ++axis) {
    TableGrid::Cell before = c, after = c;
    double turn = 0;  // phi_d goes round by pi
    if (axis == 0) --before.theta_h, ++after.theta_h;
    if (axis == 1) --before.theta_d, ++after.theta_d;
    if (axis == 2) {
      turn = c.phi_d == 0 || c.phi_d == TableGrid::n_phi_d - 1 ? pi : 0;
      before.phi_d = (c.phi_d + TableGrid::n_phi_d - 1) % TableGrid::n_phi_d;
      after.phi_d = (c.phi_d + 1) % TableGrid::n_phi_d;
    }
    const std::size_t k = TableGrid::index(before), l = TableGrid::index(after);
    if (!clear(t, k) || !clear(t, l)) return {};
    const double distance = double{(*coordinates[axis])[l]} - double{(*coordinates[axis])[k]} + turn;
    if (!(distance > 0)) return {};
    g.slope[axis] = std::log(double{t.mean[l]} / double{t.mean[k]}) / distance;
    g.variance[axis] = (relative_variance(t, k) + relative_variance(t, l)) / (distance * distance);
  }
  return g;
}

}  // namespace

void CheckOptions::validate() const {
  if (!(max_theta > 0 && max_theta <= pi / 2)) throw Error(ErrorCode::usage, "max_theta: expected an angle above 0 and at most 90 deg");
  if (!(resolution >= 4 && resolution <= 4096)) throw Error(ErrorCode::usage, "resolution: expected 4 to 4096");
  for (const double t : theta_i)
    if (!(t >= 0 && t < pi / 2)) throw Error(ErrorCode::usage, "theta_i: expected angles from 0 to less than 90 deg");
}

bool Reflectance::conserves_energy() const {
  bool conserves = true;
  for (int c = 0; c < 3; ++c) conserves &= value[c] <= 1 + 2 * sigma[c];
  return conserves;
}

PhysicalChecks check_physics(const Brdf& brdf, const CheckOptions& options) {
  options.validate();
  PhysicalChecks checks;
  std::vector<double> swapped, mirrored;
  const double min_cosine = std::cos(options.max_theta);
  constexpr std::size_t step = 3;  // a third of the cells says as much, at a third of the time
  for (std::size_t i = 0; i < TableGrid::n_cells; i += step) {
    if (!TableGrid::reachable(TableGrid::cell(i), min_cosine)) continue;
    const HalfDiff centre = TableGrid::centre(i);
    const Directions d = directions(centre);
    const auto f = brdf.value(d);
    checks.n_directions += 3;
    if (!f) {
      checks.n_undefined += 3;
      continue;
    }
    for (int c = 0; c < 3; ++c) {
      checks.n_negative += (*f)[c] < 0;
      checks.n_zero += (*f)[c] == 0;
      checks.most_negative = std::min(checks.most_negative, (*f)[c]);
    }
    if (const auto g = brdf.value({d.wo, d.wi})) add_logs(*f, *g, swapped);
    if (const auto g = brdf.value(directions({centre.theta_h, centre.theta_d, -centre.phi_d}))) add_logs(*f, *g, mirrored);
  }
  checks.reciprocity = asymmetry(swapped);
  checks.mirror = asymmetry(mirrored);

  std::vector<double> angles = options.theta_i;
  if (angles.empty())
    for (int k = 0; k < 9; ++k) angles.push_back(k * pi / 18);
  checks.reflectances.resize(angles.size());
  tbb::parallel_for(std::size_t{0}, angles.size(), [&](std::size_t k) { checks.reflectances[k] = reflectance(brdf, angles[k], options.resolution); });
  return checks;
}

MirrorRepeatability mirror_repeatability(const TableChannel& t) {
  std::vector<double> logs, sizes, sigmas;
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
    const std::size_t j = TableGrid::mirror(i);
    if (j < i || !clear(t, i) || !clear(t, j)) continue;
    const auto gradient = log_gradient(t, i), other = log_gradient(t, j);
    if (!gradient || !other) continue;
    // To first order of the paint's slope the values move to the same place; the slope's own noise counts.
    const glm::dvec3 apart(double{t.theta_h[i]} - double{t.theta_h[j]}, double{t.theta_d[i]} - double{t.theta_d[j]}, double{t.phi_d[i]} - (pi - double{t.phi_d[j]}));
    const glm::dvec3 slope = 0.5 * (gradient->slope + other->slope * glm::dvec3(1, 1, -1));
    logs.push_back(std::log(double{t.mean[i]} / double{t.mean[j]}) - glm::dot(slope, apart));
    sizes.push_back(std::abs(logs.back()));
    sigmas.push_back(std::sqrt(relative_variance(t, i) + relative_variance(t, j) + 0.25 * glm::dot(gradient->variance + other->variance, apart * apart)));
  }
  MirrorRepeatability r;
  r.n_pairs = logs.size();
  r.bias_log = median(logs);
  r.scatter_log = median(sizes) / 0.6745;
  r.expected_log = median(sigmas);
  return r;
}

bool smaller_than_footprint(const TableChannel& t, std::size_t i) {
  const int h = TableGrid::cell(i).theta_h;
  return std::sqrt(double{t.footprint_along[i]}) > TableGrid::theta_h_edge(h + 1) - TableGrid::theta_h_edge(h);
}

}  // namespace lacquer::brdf
