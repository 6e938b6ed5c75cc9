#include "libcalib/limb_profile.h"

#include <algorithm>
#include <cmath>

#include "libcalib/response_algebra.h"

namespace lacquer::calib {

namespace {

constexpr double pi = 3.14159265358979323846;
constexpr double table_step = 1.0 / 32;  // pixels; cubic between, so that the cost of a fit is smooth

struct LinearFit {
  double cost = 0, step = 0;
};

LinearFit fit_at(const std::vector<LimbValue>& values, double shift, const BlurredLimb& limb) {
  constexpr std::size_t n = 4;
  double a[n][n]{}, b[n]{};
  static thread_local std::vector<std::array<double, 4>> rows;
  rows.clear();
  for (const LimbValue& v : values) {
    const auto mean = limb.at(v.distance - shift);
    rows.push_back({1, mean[0], mean[1], mean[2]});
    const double w = 1 / v.variance;
    for (std::size_t r = 0; r < n; ++r) {
      b[r] += w * rows.back()[r] * v.radiance;
      for (std::size_t c = 0; c <= r; ++c) a[r][c] += w * rows.back()[r] * rows.back()[c];
    }
  }
  SymmetricMatrix matrix(n);
  for (std::size_t r = 0; r < n; ++r)
    for (std::size_t c = 0; c <= r; ++c) matrix.at(r, c) = a[r][c];
  const std::vector<double> x = solve(matrix, {b, b + n});
  LinearFit fit;
  for (std::size_t i = 0; i < values.size(); ++i) {
    double r = values[i].radiance;
    for (std::size_t k = 0; k < n; ++k) r -= x[k] * rows[i][k];
    fit.cost += r * r / values[i].variance;
  }
  fit.step = x[1] + x[2];  // one pixel inside
  return fit;
}

}  // namespace

std::array<double, 3> BlurredLimb::integrate(double distance, double sigma) {
  constexpr int n = 24;  // midpoints in u = sqrt(depth), where the integrand is smooth
  std::array<double, 3> mean{};
  const double deepest = 5 * sigma - distance, shallowest = std::max(0.0, -5 * sigma - distance);
  if (!(deepest > 0)) return mean;
  const double u0 = std::sqrt(shallowest), u1 = std::sqrt(deepest);
  for (int i = 0; i < n; ++i) {
    const double u = u0 + (u1 - u0) * (i + 0.5) / n, t = u * u, z = (t + distance) / sigma;
    const double weight = 2 * u * (u1 - u0) / n * std::exp(-0.5 * z * z) / (sigma * std::sqrt(2 * pi));
    mean[0] += weight;
    mean[1] += weight * u;
    mean[2] += weight * t;
  }
  return mean;
}

BlurredLimb::BlurredLimb(double sigma, double deepest) : sigma_(sigma), deepest_(deepest) {
  const auto n = static_cast<std::size_t>((deepest + 5 * sigma) / table_step) + 4;
  for (std::size_t i = 0; i < n; ++i) table_.push_back(integrate(-deepest + (static_cast<double>(i) - 1) * table_step, sigma));
}

std::array<double, 3> BlurredLimb::at(double distance) const {
  const double x = (distance + deepest_) / table_step;
  if (!(x >= 0) || x >= static_cast<double>(table_.size() - 3)) return integrate(distance, sigma_);
  const auto i = static_cast<std::size_t>(x);
  const double t = x - static_cast<double>(i);
  // Lagrange through the four nodes around.
  const double w[] = {-t * (t - 1) * (t - 2) / 6, (t + 1) * (t - 1) * (t - 2) / 2, -(t + 1) * t * (t - 2) / 2, (t + 1) * t * (t - 1) / 6};
  std::array<double, 3> mean{};
  for (std::size_t k = 0; k < 4; ++k)
    for (std::size_t c = 0; c < 3; ++c) mean[c] += w[k] * table_[i + k][c];
  return mean;
}

LimbFit fit_limb(const std::vector<LimbValue>& values, const BlurredLimb& limb, double reach) {
  LimbFit fit;
  if (values.size() < 6) return fit;
  double best = 0, best_cost = 1e300;
  constexpr int n_steps = 12;
  for (int i = -n_steps; i <= n_steps; ++i) {
    const double shift = reach * i / n_steps, cost = fit_at(values, shift, limb).cost;
    if (cost < best_cost) {
      best = shift;
      best_cost = cost;
    }
  }
  if (std::abs(best) > 0.95 * reach) return fit;
  // Golden section.
  double low = best - reach / n_steps, high = best + reach / n_steps;
  constexpr double golden = 0.38196601125010515;
  double p = low + golden * (high - low), q = high - golden * (high - low);
  double cost_p = fit_at(values, p, limb).cost, cost_q = fit_at(values, q, limb).cost;
  for (int i = 0; i < 20; ++i) {
    if (cost_p < cost_q) {
      high = q;
      q = p;
      cost_q = cost_p;
      p = low + golden * (high - low);
      cost_p = fit_at(values, p, limb).cost;
    } else {
      low = p;
      p = q;
      cost_p = cost_q;
      q = high - golden * (high - low);
      cost_q = fit_at(values, q, limb).cost;
    }
  }
  fit.shift = 0.5 * (low + high);
  constexpr double h = 0.05;
  const LinearFit here = fit_at(values, fit.shift, limb);
  const double curvature = (fit_at(values, fit.shift - h, limb).cost - 2 * here.cost + fit_at(values, fit.shift + h, limb).cost) / (h * h);
  if (!(curvature > 0)) return fit;
  fit.cost = here.cost;
  fit.reduced = here.cost / (static_cast<double>(values.size()) - 5);
  fit.sigma = std::sqrt(2 * std::max(1.0, fit.reduced) / curvature);
  fit.good = fit.sigma < 0.5 && here.step > 0;
  return fit;
}

}  // namespace lacquer::calib
