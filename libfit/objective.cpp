#include "libfit/objective.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "libfit/second_order.h"

namespace lacquer::fit {

namespace {

constexpr std::size_t points_per_chunk = 512;
constexpr double log_floor = 1e-3;  // of the measured value, see Objective

/// One channel's parameters as seen by one observation: kd, ks of each lobe, then ln(m) and r of each lobe.
constexpr int max_lobes = 5;
constexpr int max_local = 1 + 3 * max_lobes;

struct Residual {
  double value;      // in sigmas
  double slope;      // by the model's value
  double curvature;  // second derivative
};

Residual residual(const Observation& o, double f) {
  if (!o.logarithmic) return {(f - o.mean) * o.inverse_sigma, o.inverse_sigma, 0};
  const double floor = log_floor * o.mean;
  const double slope = o.inverse_sigma / (f + floor);
  return {(std::log((f + floor) / (o.mean + floor)) - o.log_bias) * o.inverse_sigma, slope,
          -slope / (f + floor)};
}

/// Huber: rho(r) = r^2 up to `scale`, 2 scale |r| - scale^2 beyond; `weight` = rho' / 2r, `curvature` = rho''
/// / 2.
struct Huber {
  double rho, weight = 1, curvature = 1;
  Huber(double r, double scale) : rho(r * r) {
    const double size = std::abs(r);
    if (!(size > scale)) return;
    weight = scale / size;
    curvature = 0;
    rho = scale * (2 * size - scale);
  }
};

/// Sums of one chunk, per channel; upper triangles.
struct ChannelSums {
  double cost = 0;
  std::array<double, max_local> gradient{};
  std::array<std::array<double, max_local>, max_local> curvature{};

  /// Adds slope * row to the gradient and factor * row row^T to the curvature.
  void add(const std::array<double, max_local>& row, int n, double slope, double factor) {
    for (int i = 0; i < n; ++i) {
      const double scaled = factor * row[i];
      gradient[i] += slope * row[i];
      for (int j = i; j < n; ++j) curvature[i][j] += scaled * row[j];
    }
  }
  void add(const ChannelSums& other, int n) {
    cost += other.cost;
    for (int i = 0; i < n; ++i) {
      gradient[i] += other.gradient[i];
      for (int j = i; j < n; ++j) curvature[i][j] += other.curvature[i][j];
    }
  }
};
using Sums = std::array<ChannelSums, 3>;

/// Position of local parameter `i` of a channel in the solver's vector.
int global_index(const ParameterLayout& layout, int channel, int i) {
  if (i == 0) return layout.kd(channel);
  if (i <= layout.n_lobes) return layout.ks(i - 1, channel);
  const int shape = i - 1 - layout.n_lobes;
  return shape % 2 == 0 ? layout.log_m(shape / 2) : layout.r(shape / 2);
}

/// A lobe for ks = 1, differentiated by ln(m) and r.
SecondOrder lobe_with_derivatives(double m, double r, const brdf::HalfAngleCosines<double>& c) {
  const SecondOrder by_log_m{.value = m, .d1 = m, .d11 = m}, by_r{.value = r, .d2 = 1};
  return brdf::CookTorranceLobe<SecondOrder>{by_log_m, by_r}(c);
}

/// Adds the observations of one point.
void add_point(const Observations& observations, const Point& point, const ParameterLayout& layout,
               const brdf::CookTorrance& model, double robust_scale, Curvature kind, Sums& sums) {
  const int n_lobes = layout.n_lobes, n = 1 + 3 * n_lobes;
  std::array<SecondOrder, max_lobes> lobes;
  for (int l = 0; l < n_lobes; ++l)
    lobes[l] = lobe_with_derivatives(model.lobes[l].m, model.lobes[l].r, point.cosines);

  std::array<double, max_local> row;  // gradient of the model's value
  row[0] = std::numbers::inv_pi;
  for (std::uint32_t k = point.first; k < point.end; ++k) {
    const Observation& o = observations.values[k];
    double f = model.kd[o.channel] * std::numbers::inv_pi;
    for (int l = 0; l < n_lobes; ++l) {
      const double ks = model.lobes[l].ks[o.channel];
      f += ks * lobes[l].value;
      row[1 + l] = lobes[l].value;
      row[1 + n_lobes + 2 * l] = ks * lobes[l].d1;
      row[2 + n_lobes + 2 * l] = ks * lobes[l].d2;
    }
    const Residual r = residual(o, f);
    const Huber huber(r.value, robust_scale);
    const double pull = huber.weight * r.value;  // derivative of rho / 2 by the residual
    ChannelSums& channel = sums[o.channel];
    channel.cost += huber.rho;
    if (kind == Curvature::gauss_newton) {
      channel.add(row, n, pull * r.slope, huber.weight * r.slope * r.slope);
      continue;
    }
    channel.add(row, n, pull * r.slope, huber.curvature * r.slope * r.slope + pull * r.curvature);
    // Second derivatives of the model's value; it is bilinear in ks and a lobe.
    for (int l = 0; l < n_lobes; ++l) {
      const double ks = model.lobes[l].ks[o.channel], slope = pull * r.slope;
      const int m = 1 + n_lobes + 2 * l;
      channel.curvature[1 + l][m] += slope * lobes[l].d1;
      channel.curvature[1 + l][m + 1] += slope * lobes[l].d2;
      channel.curvature[m][m] += slope * ks * lobes[l].d11;
      channel.curvature[m][m + 1] += slope * ks * lobes[l].d12;
      channel.curvature[m + 1][m + 1] += slope * ks * lobes[l].d22;
    }
  }
}

/// Share of a lobe's light that leaves the surface at normal incidence, and its derivative by ln(m).
struct Escape {
  double value, d_log_m;
  explicit Escape(double m) {
    const double x = 0.6 / (m * m);
    value = -std::expm1(-x);
    d_log_m = -2 * x * std::exp(-x);
  }
};

/// Residual of the energy penalty of one channel: 0 while the albedo is at most 1. Scaled by the number of
/// observations, so that it means the same for any table. Its square is smooth.
double energy_residual(double albedo, double weight, std::size_t n_values) {
  return std::max(0.0, albedo - 1) * weight * std::sqrt(static_cast<double>(n_values));
}

void add_energy(const ParameterLayout& layout, const brdf::CookTorrance& model, double weight,
                std::size_t n_values, Quadratic& q) {
  const glm::dvec3 albedo = normal_incidence_albedo(model);
  const double slope = weight * std::sqrt(static_cast<double>(n_values));
  const int n = layout.size();
  for (int c = 0; c < layout.n_channels; ++c) {
    const double r = energy_residual(albedo[c], weight, n_values);
    if (r == 0) continue;
    std::vector<double> row(static_cast<std::size_t>(n));
    row[layout.kd(c)] = slope;
    for (int l = 0; l < layout.n_lobes; ++l) {
      const auto& lobe = model.lobes[l];
      const Escape escape(lobe.m);
      row[layout.ks(l, c)] = slope * 4 * lobe.r * escape.value;
      row[layout.log_m(l)] = slope * 4 * lobe.ks[c] * lobe.r * escape.d_log_m;
      row[layout.r(l)] = slope * 4 * lobe.ks[c] * escape.value;
    }
    q.cost += r * r;
    for (int i = 0; i < n; ++i) {
      q.gradient[i] += row[i] * r;
      for (int j = 0; j < n; ++j) q.curvature[i * n + j] += row[i] * row[j];
    }
  }
}

}  // namespace

glm::dvec3 normal_incidence_albedo(const brdf::CookTorrance& model) {
  glm::dvec3 albedo = model.kd;
  for (const auto& lobe : model.lobes) albedo += lobe.ks * (4 * lobe.r * Escape(lobe.m).value);
  return albedo;
}

Objective::Objective(const Observations& observations, ParameterLayout layout, ObjectiveOptions options)
    : observations_(&observations), layout_(layout), options_(options) {}

double Objective::cost(const std::vector<double>& x) const {
  const brdf::CookTorrance model = layout_.unpack(x);
  const auto& points = observations_->points;
  std::vector<double> chunks((points.size() + points_per_chunk - 1) / points_per_chunk);
  tbb::parallel_for(std::size_t{0}, chunks.size(), [&](std::size_t chunk) {
    const std::size_t end = std::min(points.size(), (chunk + 1) * points_per_chunk);
    double sum = 0;
    for (std::size_t i = chunk * points_per_chunk; i < end; ++i) {
      const glm::dvec3 f = model.value(points[i].cosines);
      for (std::uint32_t k = points[i].first; k < points[i].end; ++k) {
        const Observation& o = observations_->values[k];
        sum += Huber(residual(o, f[o.channel]).value, options_.robust_scale).rho;
      }
    }
    chunks[chunk] = sum;
  });
  double total = 0;
  for (const double chunk : chunks) total += chunk;
  const glm::dvec3 albedo = normal_incidence_albedo(model);
  for (int c = 0; c < layout_.n_channels; ++c) {
    const double r = energy_residual(albedo[c], options_.energy_weight, observations_->values.size());
    total += r * r;
  }
  return total;
}

Quadratic Objective::quadratic(const std::vector<double>& x, Curvature kind) const {
  const brdf::CookTorrance model = layout_.unpack(x);
  const auto& points = observations_->points;
  std::vector<Sums> chunks((points.size() + points_per_chunk - 1) / points_per_chunk);
  tbb::parallel_for(std::size_t{0}, chunks.size(), [&](std::size_t chunk) {
    const std::size_t end = std::min(points.size(), (chunk + 1) * points_per_chunk);
    for (std::size_t i = chunk * points_per_chunk; i < end; ++i)
      add_point(*observations_, points[i], layout_, model, options_.robust_scale, kind, chunks[chunk]);
  });

  const int n = layout_.size(), n_local = 1 + 3 * layout_.n_lobes;
  Quadratic q;
  q.gradient.resize(static_cast<std::size_t>(n));
  q.curvature.resize(static_cast<std::size_t>(n) * static_cast<std::size_t>(n));
  for (int c = 0; c < layout_.n_channels; ++c) {
    ChannelSums total;
    for (const Sums& chunk : chunks) total.add(chunk[static_cast<std::size_t>(c)], n_local);
    q.cost += total.cost;
    for (int i = 0; i < n_local; ++i) {
      const int gi = global_index(layout_, c, i);
      q.gradient[gi] += total.gradient[i];
      for (int j = i; j < n_local; ++j) {
        const int gj = global_index(layout_, c, j);
        q.curvature[gi * n + gj] += total.curvature[i][j];
        if (gi != gj) q.curvature[gj * n + gi] += total.curvature[i][j];
      }
    }
  }
  add_energy(layout_, model, options_.energy_weight, observations_->values.size(), q);
  return q;
}

}  // namespace lacquer::fit
