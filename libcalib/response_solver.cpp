#include "libcalib/response_solver.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace lacquer::calib {

namespace {

/// Knots above this are not needed by any real sensor; 8 bits get one per level.
constexpr int max_knots = 320;
/// Residuals beyond this many sigmas count as contradictions (moved edge, dust, border of a registered photograph).
constexpr double cauchy_sigmas = 4;

/// Solves the symmetric positive definite system a x = b in place (Cholesky, lower triangle, row-major n x n).
void solve_cholesky(std::vector<double>& a, std::vector<double>& b) {
  const std::size_t n = b.size();
  for (std::size_t j = 0; j < n; ++j) {
    for (std::size_t i = j; i < n; ++i) {
      const double* row_i = &a[i * n];
      const double* row_j = &a[j * n];
      const double sum = a[i * n + j] - std::inner_product(row_i, row_i + j, row_j, 0.0);
      a[i * n + j] = i == j ? std::sqrt(sum) : sum / a[j * n + j];
    }
  }
  for (std::size_t i = 0; i < n; ++i) b[i] = (b[i] - std::inner_product(&a[i * n], &a[i * n] + i, b.begin(), 0.0)) / a[i * n + i];
  for (std::size_t i = n; i-- > 0;) {
    for (std::size_t k = i + 1; k < n; ++k) b[i] -= a[k * n + i] * b[k];
    b[i] /= a[i * n + i];
  }
}

/// Pool adjacent violators: the non-decreasing sequence closest to `y`, then a rise of `min_step` between neighbours so that the
/// curve can be inverted.
void make_increasing(std::vector<double>& y, std::size_t first, double min_step) {
  struct Block {
    double sum;
    std::size_t n;
    double mean() const { return sum / static_cast<double>(n); }
  };
  std::vector<Block> blocks;
  for (std::size_t i = first; i < y.size(); ++i) {
    blocks.push_back({y[i], 1});
    while (blocks.size() > 1 && blocks[blocks.size() - 2].mean() >= blocks.back().mean()) {
      blocks[blocks.size() - 2].sum += blocks.back().sum;
      blocks[blocks.size() - 2].n += blocks.back().n;
      blocks.pop_back();
    }
  }
  std::size_t i = first;
  for (const Block& block : blocks)
    for (std::size_t k = 0; k < block.n; ++k) y[i++] = block.mean();
  for (i = first + 1; i < y.size(); ++i) y[i] = std::max(y[i], y[i - 1] + min_step);
}

}  // namespace

/// Normal equations of h, lower triangle.
struct ResponseSolver::Normal {
  explicit Normal(std::size_t n) : a(n * n), b(n) {}
  void add(std::size_t i, std::size_t k, double value) { a[std::max(i, k) * b.size() + std::min(i, k)] += value; }
  std::vector<double> a, b;
};

ResponseSolver::ResponseSolver(int bits, double black_level, const SampledPixels& pixels, const std::vector<double>& times,
                               double slope_change)
    : bits_(bits), black_(black_level), pixels_(pixels), times_(times), slope_change_(slope_change) {
  // Knots at integer values, spaced with the square root of the signal: as dense as shot noise allows to tell levels apart.
  const int first = static_cast<int>(std::floor(black_level)) + 1, last = (1 << bits) - 1;
  std::vector<int> values;
  for (int k = 0; k <= max_knots; ++k) {
    const double s = static_cast<double>(k) / max_knots;
    const int v = last - first <= max_knots ? first + k : first + static_cast<int>(std::lround(s * s * (last - first)));
    if (v <= last && (values.empty() || v > values.back())) values.push_back(v);
  }
  for (const int v : values) knots_.push_back(std::log(v - black_level));
  interpolation_.resize(static_cast<std::size_t>(last) + 1, {0, 0.0});
  for (std::size_t k = 0; k + 1 < values.size(); ++k)
    for (int v = values[k]; v <= values[k + 1]; ++v)
      interpolation_[static_cast<std::size_t>(v)] = {static_cast<int>(k),
                                                     (std::log(v - black_level) - knots_[k]) / (knots_[k + 1] - knots_[k])};
  h_.assign(knots_.size(), 0.0);
}

double ResponseSolver::log_exposure(int value) const {
  const Interpolation at = interpolation_[static_cast<std::size_t>(value)];
  const auto k = static_cast<std::size_t>(at.knot);
  return std::log(value - black_) + (1 - at.upper) * h_[k] + at.upper * h_[k + 1];
}

void ResponseSolver::add_pixel(std::size_t pixel, const std::vector<double>& weights, bool robust, Normal& normal) const {
  struct Row {
    Interpolation at;
    double weight, target;
  };
  std::vector<Row> rows;
  double sum_w = 0, sum_wy = 0, sum_wg = 0;
  for (std::size_t o = pixels_.first[pixel]; o < pixels_.first[pixel + 1]; ++o) {
    const Observation obs = pixels_.observations[o];
    const double w = weights[obs.value];
    if (w <= 0) continue;
    const double log_t = std::log(times_[obs.time]);
    rows.push_back({interpolation_[obs.value], w, log_t - std::log(obs.value - black_)});
    sum_wg += w * (robust ? log_exposure(obs.value) - log_t : 0.0);
    sum_w += w;
  }
  if (rows.size() < 2) return;
  if (robust) {
    const double mean = sum_wg / sum_w;
    sum_w = 0;
    for (Row& r : rows) {
      const auto k = static_cast<std::size_t>(r.at.knot);
      const double residual = (1 - r.at.upper) * h_[k] + r.at.upper * h_[k + 1] - r.target - mean;
      r.weight /= 1 + residual * residual * r.weight / (cauchy_sigmas * cauchy_sigmas);
      sum_w += r.weight;
    }
  }
  for (const Row& r : rows) sum_wy += r.weight * r.target;
  for (std::size_t p = 0; p < rows.size(); ++p) {
    const auto k = static_cast<std::size_t>(rows[p].at.knot);
    const double lower_p = rows[p].weight * (1 - rows[p].at.upper), upper_p = rows[p].weight * rows[p].at.upper;
    const double centred = rows[p].target - sum_wy / sum_w;
    normal.b[k] += lower_p * centred;
    normal.b[k + 1] += upper_p * centred;
    normal.add(k, k, lower_p * (1 - rows[p].at.upper));
    normal.add(k + 1, k, lower_p * rows[p].at.upper);
    normal.add(k + 1, k + 1, upper_p * rows[p].at.upper);
    for (std::size_t q = 0; q < rows.size(); ++q) {
      const auto m = static_cast<std::size_t>(rows[q].at.knot);
      const double lower_q = rows[q].weight * (1 - rows[q].at.upper) / sum_w, upper_q = rows[q].weight * rows[q].at.upper / sum_w;
      // Only the lower triangle: of each unordered pair of knots one of the two visits (p, q) and (q, p) writes.
      if (k >= m) normal.add(k, m, -lower_p * lower_q);
      if (k + 1 >= m) normal.add(k + 1, m, -upper_p * lower_q);
      if (k >= m + 1) normal.add(k, m + 1, -lower_p * upper_q);
      if (k + 1 >= m + 1) normal.add(k + 1, m + 1, -upper_p * upper_q);
    }
  }
}

void ResponseSolver::add_smoothness(Normal& normal) const {
  for (std::size_t k = 1; k + 1 < knots_.size(); ++k) {
    const double below = knots_[k] - knots_[k - 1], above = knots_[k + 1] - knots_[k], span = (below + above) / 2;
    // Second derivative; its square is integrated over log(v - black).
    const double d[3] = {1 / (below * span), -1 / (below * span) - 1 / (above * span), 1 / (above * span)};
    const double strength = span / (slope_change_ * slope_change_);
    for (std::size_t p = 0; p < 3; ++p)
      for (std::size_t q = 0; q <= p; ++q) normal.add(k - 1 + p, k - 1 + q, strength * d[p] * d[q]);
  }
}

std::vector<double> ResponseSolver::curve() const {
  const auto n = std::size_t{1} << bits_;
  const auto first = static_cast<std::size_t>(std::floor(black_)) + 1;
  std::vector<double> exposure(n);
  for (std::size_t v = first; v < n; ++v) exposure[v] = std::exp(log_exposure(static_cast<int>(v)));
  make_increasing(exposure, first, 1e-6 * exposure[n / 2] / static_cast<double>(n));
  const double scale = (static_cast<double>(n / 2) - black_) / exposure[n / 2];
  for (std::size_t v = first; v < n; ++v) exposure[v] *= scale;
  // Below: the straight line through (black, 0), so that noise around black keeps its sign.
  const double slope = exposure[first] / (static_cast<double>(first) - black_);
  for (std::size_t v = 0; v < first; ++v) exposure[v] = (static_cast<double>(v) - black_) * slope;
  return exposure;
}

double ResponseSolver::residual_rms(const std::vector<double>& weights) const {
  double sum = 0, n = 0;
  for (std::size_t i = 0; i < pixels_.n_pixels(); ++i) {
    double w = 0, wg = 0, wgg = 0;
    int count = 0;
    for (std::size_t o = pixels_.first[i]; o < pixels_.first[i + 1]; ++o) {
      const Observation obs = pixels_.observations[o];
      if (weights[obs.value] <= 0) continue;
      const double g = log_exposure(obs.value) - std::log(times_[obs.time]);
      w += weights[obs.value];
      wg += weights[obs.value] * g;
      wgg += weights[obs.value] * g * g;
      ++count;
    }
    if (count < 2) continue;
    sum += std::max(wgg - wg * wg / w, 0.0);
    n += w;
  }
  return n > 0 ? std::sqrt(sum / n) : 0;
}

ResponseSolver::Step ResponseSolver::solve(const std::vector<double>& weights, bool robust) {
  Normal normal(knots_.size());
  for (std::size_t i = 0; i < pixels_.n_pixels(); ++i) add_pixel(i, weights, robust, normal);
  add_smoothness(normal);
  // The data say nothing about the mean of h (gauge) and, with few levels, hardly anything about its slope: a prior far weaker than
  // any data (h = 0 +- 10, so a factor e^10) makes the system definite.
  for (std::size_t k = 0; k < knots_.size(); ++k) normal.add(k, k, 0.01 / static_cast<double>(knots_.size()));
  solve_cholesky(normal.a, normal.b);
  h_ = normal.b;
  return {curve(), residual_rms(weights)};
}

}  // namespace lacquer::calib
