#include "libcalib/transfer_fit.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace lacquer::calib {

namespace {

using Use = TransferPoint::Use;

constexpr double significance = 3;      ///< sigmas: a term of the model that is less is left out
constexpr double misfit_sigmas = 3.5;   ///< chi^2 beyond this many of its own standard deviations is no chance
constexpr double drop_sigmas = 5;
constexpr double drop_fraction = 0.03;  ///< a curve of a few per cent is a matter of linearity, not of saturation
/// Below six times the quantisation variance (half a DN^2) rounding is not yet independent of the value: at 0.65 DN of noise the variance
/// of rounded normal numbers is off by up to (4 s^2 + 1 / pi^2) exp(-2 pi^2 s^2) = 5e-4 DN^2, growing fast below.
constexpr double quantised_ratio = 6;

/// Symmetric positive definite 3 x 3 (or its leading n x n part), inverted by Gauss-Jordan without pivots after scaling the diagonal to 1.
/// False where it is singular to 1e-10.
bool invert(std::array<std::array<double, 3>, 3>& m, std::size_t n) {
  std::array<double, 3> scale{};
  for (std::size_t i = 0; i < n; ++i) {
    if (!(m[i][i] > 0)) return false;
    scale[i] = 1 / std::sqrt(m[i][i]);
  }
  std::array<std::array<double, 6>, 3> a{};
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t k = 0; k < n; ++k) a[i][k] = m[i][k] * scale[i] * scale[k];
    a[i][n + i] = 1;
  }
  for (std::size_t i = 0; i < n; ++i) {
    if (!(a[i][i] > 1e-10)) return false;
    const double inverse = 1 / a[i][i];
    for (double& value : a[i]) value *= inverse;
    for (std::size_t r = 0; r < n; ++r) {
      if (r == i) continue;
      const double factor = a[r][i];
      for (std::size_t k = 0; k < 2 * n; ++k) a[r][k] -= factor * a[i][k];
    }
  }
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t k = 0; k < n; ++k) m[i][k] = a[i][n + k] * scale[i] * scale[k];
  return true;
}

std::array<double, 3> row_of(const TransferPoint& p) { return {1, p.mean, p.light_square}; }

struct Solution {
  std::array<double, 3> x{};
  std::array<std::array<double, 3>, 3> covariance{};
  bool good = false;
};

Solution solve(std::span<const TransferPoint> points, const TransferLine& weights, std::size_t n_terms) {
  Solution s;
  std::array<double, 3> right{};
  for (const TransferPoint& p : points) {
    if (p.use != Use::fitted) continue;
    const double w = 1 / variance_of_variance(weights, p);
    const auto row = row_of(p);
    for (std::size_t i = 0; i < n_terms; ++i) {
      right[i] += w * row[i] * p.variance;
      for (std::size_t k = 0; k < n_terms; ++k) s.covariance[i][k] += w * row[i] * row[k];
    }
  }
  s.good = invert(s.covariance, n_terms);
  if (!s.good) return s;
  for (std::size_t i = 0; i < n_terms; ++i)
    for (std::size_t k = 0; k < n_terms; ++k) s.x[i] += s.covariance[i][k] * right[k];
  return s;
}

double chi_square_of(std::span<const TransferPoint> points, const TransferLine& line) {
  double sum = 0;
  for (const TransferPoint& p : points) {
    if (p.use != Use::fitted) continue;
    const double residual = p.variance - line.at(p);
    sum += residual * residual / variance_of_variance(line, p);
  }
  return sum;
}

/// A crude line to start the weights from: never 0 or negative.
TransferLine first_guess(std::span<const TransferPoint> points) {
  TransferLine line;
  double variance = 0, mean = 0;
  line.constant = 1e300;
  for (const TransferPoint& p : points) {
    if (p.use != Use::fitted) continue;
    line.constant = std::min(line.constant, std::max(p.variance, p.quantisation));
    variance += std::max(p.variance, p.quantisation);
    mean += std::max(p.mean, 0.0);
  }
  line.slope = mean > 0 ? variance / mean : 0;
  return line;
}

TransferLine fit_terms(std::span<const TransferPoint> points, int n_points, std::size_t n_terms) {
  TransferLine line = first_guess(points);
  Solution s;
  for (int iteration = 0; iteration < 50; ++iteration) {
    s = solve(points, line, n_terms);
    if (!s.good) return {};
    TransferLine next;
    next.constant = s.x[0];
    next.slope = n_terms > 1 ? s.x[1] : 0;
    next.square = n_terms > 2 ? s.x[2] : 0;
    double change = std::abs(next.constant - line.constant) / std::sqrt(s.covariance[0][0]);
    if (n_terms > 1) change += std::abs(next.slope - line.slope) / std::sqrt(s.covariance[1][1]);
    line = next;
    if (change < 1e-6) break;  // a millionth of a standard error
  }
  line.chi_square = chi_square_of(points, line);
  line.degrees_of_freedom = n_points - static_cast<int>(n_terms);
  line.has_slope = n_terms > 1;
  line.has_square = n_terms > 2;
  const double dof = line.degrees_of_freedom;
  const bool misfit = dof > 0 && line.chi_square > dof + misfit_sigmas * std::sqrt(2 * dof);
  const double widened = misfit ? line.chi_square / dof : 1;
  line.constant_variance = s.covariance[0][0] * widened;
  if (n_terms > 1) line.slope_variance = s.covariance[1][1] * widened;
  if (n_terms > 1) line.covariance = s.covariance[0][1] * widened;
  if (n_terms > 2) line.square_variance = s.covariance[2][2] * widened;
  return line;
}

/// The level where the variance first falls off the straight line that the levels below make; the end of `points` (by mean) if it never
/// does. Straight: noise that grows faster than the line is no drop, and a bend read into few points would lead anywhere. At least two
/// flats below: dark frames alone do not say what the flats will do.
std::size_t first_drop(const std::vector<TransferPoint>& points) {
  int n_flats = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (points[i].use != Use::fitted) return i;
    if (points[i].dark || n_flats++ < 2) continue;
    const TransferLine line = fit_terms(std::span(points.data(), i), static_cast<int>(i), 2);
    if (!line.has_slope) continue;
    const double m = points[i].mean, predicted = line.at(points[i]);
    const double prediction_variance = line.constant_variance + 2 * m * line.covariance + m * m * line.slope_variance;
    const double sigma = std::sqrt(variance_of_variance(line, points[i]) + prediction_variance);
    const double missing = predicted - points[i].variance;
    if (missing > drop_sigmas * sigma && missing > drop_fraction * predicted) return i;
  }
  return points.size();
}

bool too_quantised(const TransferPoint& p) { return p.variance + p.quantisation < quantised_ratio * p.quantisation; }

void leave_out_quantised(std::vector<TransferPoint>& points) {
  int others = 0;
  double low = 1e300, high = 0;
  for (const TransferPoint& p : points)
    if (p.use == Use::fitted && !too_quantised(p)) {
      ++others;
      low = std::min(low, p.mean);
      high = std::max(high, p.mean);
    }
  if (others < 3 || !(high > 2 * low)) return;  // too few to do without
  for (TransferPoint& p : points)
    if (p.use == Use::fitted && too_quantised(p)) p.use = Use::quantised;
}

}  // namespace

double variance_of_variance(const TransferLine& line, const TransferPoint& p) {
  // Rounding gives at least its own variance, whatever the line says.
  const double total = std::max(line.at(p), 0.0) + p.quantisation;
  const double spread = line.slope * line.slope * std::max(p.light_square - p.light * p.light, 0.0);
  const double fourth = std::pow(std::max(line.slope, 0.0), 3) * std::max(p.mean, 0.0);
  return (2 * (total * total + spread) + 0.5 * fourth) / p.n_values;
}

TransferLine fit_transfer_line(std::span<const TransferPoint> points) {
  int n = 0;
  double low = 1e300, high = -1e300;
  for (const TransferPoint& p : points) {
    if (p.use != Use::fitted) continue;
    ++n;
    low = std::min(low, p.mean);
    high = std::max(high, p.mean);
  }
  if (n == 0) return {};
  if (n < 2 || !(high - low > 0)) return fit_terms(points, n, 1);
  const TransferLine straight = fit_terms(points, n, 2);
  if (!straight.has_slope) return fit_terms(points, n, 1);
  if (n < 4) return straight;
  const TransferLine curved = fit_terms(points, n, 3);
  const bool significant = curved.has_square && curved.square > significance * std::sqrt(curved.square_variance) && curved.slope > 0;
  return significant ? curved : straight;
}

void choose_points(std::vector<TransferPoint>& points) {
  leave_out_quantised(points);
  // Rounding noise of quantised points would bend the line that later levels are compared with.
  std::vector<TransferPoint> candidates;
  for (const TransferPoint& p : points)
    if (p.use != Use::quantised && !(p.dark && p.use == Use::clipped)) candidates.push_back(p);
  std::stable_sort(candidates.begin(), candidates.end(), [](const TransferPoint& a, const TransferPoint& b) { return a.mean < b.mean; });
  const std::size_t drop = first_drop(candidates);
  if (drop == candidates.size()) return;
  const double top = candidates[drop].mean;
  const TransferLine line = fit_transfer_line(std::span(candidates.data(), drop));
  for (TransferPoint& p : points) {
    if (p.use != Use::fitted) continue;
    const double reach = p.mean + 4 * std::sqrt(std::max(line.at(p), 0.0));
    if (p.mean >= top || (!p.dark && reach > top)) p.use = Use::variance_drop;
  }
}

}  // namespace lacquer::calib
