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
/// Values are used from this predicted signal to noise ratio on, and up to this many sigmas below saturation ...
constexpr double min_signal_to_noise = 3, saturation_sigmas = 4;
/// ... and from this many quantisation steps on: rounding shifts the mean of what fell into a level by 1 / (12 steps^2).
constexpr double min_steps = 6;

/// 0 up to `limit`, 1 from 1.5 limits on: hard limits would let values jump in and out for ever as the curve settles.
double ramp(double x, double limit) { return std::clamp(2 * (x / limit - 1), 0.0, 1.0); }

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
void make_increasing(std::vector<double>& y, double min_step) {
  struct Block {
    double sum;
    std::size_t n;
    double mean() const { return sum / static_cast<double>(n); }
  };
  std::vector<Block> blocks;
  for (std::size_t i = 0; i < y.size(); ++i) {
    blocks.push_back({y[i], 1});
    while (blocks.size() > 1 && blocks[blocks.size() - 2].mean() >= blocks.back().mean()) {
      blocks[blocks.size() - 2].sum += blocks.back().sum;
      blocks[blocks.size() - 2].n += blocks.back().n;
      blocks.pop_back();
    }
  }
  std::size_t i = 0;
  for (const Block& block : blocks)
    for (std::size_t k = 0; k < block.n; ++k) y[i++] = block.mean();
  for (i = 1; i < y.size(); ++i) y[i] = std::max(y[i], y[i - 1] + min_step);
}

}  // namespace

/// Normal equations of the change of h, lower triangle.
struct ResponseSolver::Normal {
  explicit Normal(std::size_t n) : a(n * n), b(n), information(n) {}
  void add(std::size_t row, std::size_t column, double value) { a[row * b.size() + column] += value; }  ///< row >= column
  std::vector<double> a, b;
  std::vector<double> information;  ///< diagonal of a before the prior
};

/// One value: the change of h at `place` should be `target` plus a constant of the pixel.
struct ResponseSolver::Row {
  Place place;
  double weight;
  double target;
};

ResponseSolver::ResponseSolver(int bits, double black_level, int saturation, const SampledPixels& pixels,
                               const std::vector<double>& times)
    : bits_(bits), black_(black_level), saturation_(saturation), pixels_(pixels), times_(times) {
  // Knots at integer values, spaced with the square root of the signal: as dense as shot noise allows to tell levels apart.
  const int first = static_cast<int>(std::floor(black_level)) + 1, last = (1 << bits) - 1;
  std::vector<int> values;
  for (int k = 0; k <= max_knots; ++k) {
    const double s = static_cast<double>(k) / max_knots;
    const int v = last - first <= max_knots ? first + k : first + static_cast<int>(std::lround(s * s * (last - first)));
    if (v <= last && (values.empty() || v > values.back())) values.push_back(v);
  }
  for (const int v : values) knots_.push_back(std::log(v - black_level));
  for (const double t : times) log_times_.push_back(std::log(t));
  log_exposure_ = knots_;
}

ResponseSolver::Place ResponseSolver::place_of_log_value(double s) const {
  const auto above = std::upper_bound(knots_.begin() + 1, knots_.end() - 1, s);
  const auto k = static_cast<std::size_t>(above - knots_.begin()) - 1;
  const double step = knots_[k + 1] - knots_[k], rise = log_exposure_[k + 1] - log_exposure_[k], upper = (s - knots_[k]) / step;
  return {k, upper, std::exp(log_exposure_[k] + upper * rise - s) * rise / step};
}

ResponseSolver::Place ResponseSolver::place_of_log_exposure(double g) const {
  const auto above = std::upper_bound(log_exposure_.begin() + 1, log_exposure_.end() - 1, g);
  const auto k = static_cast<std::size_t>(above - log_exposure_.begin()) - 1;
  const double step = knots_[k + 1] - knots_[k], rise = log_exposure_[k + 1] - log_exposure_[k];
  // Below the first knot the curve is the straight line to (black, 0).
  if (g < log_exposure_[0]) return {0, 0.0, std::exp(log_exposure_[0] - knots_[0])};
  const double upper = std::min((g - log_exposure_[k]) / rise, 1.0);
  return {k, upper, std::exp(g - knots_[k] - upper * step) * rise / step};
}

void ResponseSolver::fit_power_law() {
  // gamma * s = log t + log x_i, s = log(v - black): regression within each pixel. All values well within the range count alike: a
  // shoulder must not rule the start.
  const double lowest = 8 * std::exp2(bits_ - 8);
  double covariance = 0, variance = 0;
  for (std::size_t i = 0; i < pixels_.n_pixels(); ++i) {
    double w = 0, ws = 0, wt = 0, wss = 0, wst = 0;
    for (std::size_t o = pixels_.first[i]; o < pixels_.first[i + 1]; ++o) {
      const Observation obs = pixels_.observations[o];
      const double signal = obs.value - black_;
      if (signal < lowest || obs.value > 0.9 * saturation_) continue;
      const double s = std::log(signal), t = log_times_[obs.time];
      w += 1;
      ws += s;
      wt += t;
      wss += s * s;
      wst += s * t;
    }
    if (w <= 0) continue;
    covariance += wst - ws * wt / w;
    variance += wss - ws * ws / w;
  }
  // Cameras and films have exponents of 1 to 3; anything far beyond is a bracket that says nothing.
  const double gamma = variance > 0 ? std::clamp(covariance / variance, 0.2, 5.0) : 1.0;
  const double mid = std::log(std::exp2(bits_ - 1) - black_);
  for (std::size_t k = 0; k < knots_.size(); ++k) log_exposure_[k] = mid + gamma * (knots_[k] - mid);
}

double ResponseSolver::variance_at(double z, double slope, const NoiseModel* noise) const {
  if (!noise) return slope * slope * std::exp2(2 * (bits_ - 8));
  const double read = noise->read_noise_e / noise->gain_e_per_dn, relative = noise->relative_noise * z;
  return read * read + z / noise->gain_e_per_dn + relative * relative + slope * slope / 12;
}

void ResponseSolver::collect_rows(std::size_t pixel, const NoiseModel* noise, const std::vector<double>& exposure,
                                  std::vector<Row>& rows) const {
  rows.clear();
  const std::size_t begin = pixels_.first[pixel], end = pixels_.first[pixel + 1];
  double sum_e = 0, sum_t = 0;
  for (std::size_t o = begin; o < end; ++o) {
    sum_e += exposure[pixels_.observations[o].value];
    sum_t += times_[pixels_.observations[o].time];
  }
  if (!(sum_e > 0)) return;
  const double limit = exposure[static_cast<std::size_t>(saturation_)], log_x0 = std::log(sum_e / sum_t);
  double weighted = 0, precision = 0;
  std::size_t last_time = 0, first_time = times_.size();
  for (std::size_t o = begin; o < end; ++o) {
    const Observation obs = pixels_.observations[o];
    const double log_z = log_x0 + log_times_[obs.time], z = std::exp(log_z), slope = place_of_log_exposure(log_z).slope;
    const double variance = variance_at(z, slope, noise);
    const double sigma = std::sqrt(variance);
    const double use = ramp(z / sigma, min_signal_to_noise) * ramp(z / slope, min_steps) * ramp((limit - z) / sigma, saturation_sigmas);
    if (use <= 0) continue;
    const double t = times_[obs.time];
    weighted += use * t * exposure[obs.value] / variance;
    precision += use * t * t / variance;
    rows.push_back({{obs.time, 0.0, 0.0}, use * z * z / variance, exposure[obs.value]});
    last_time = std::max<std::size_t>(last_time, obs.time);
    first_time = std::min<std::size_t>(first_time, obs.time);
  }
  if (rows.empty() || last_time <= first_time || !(weighted > 0)) {
    rows.clear();
    return;
  }
  const double log_x = std::log(weighted / precision);
  for (Row& r : rows) {
    const double log_z = log_x + log_times_[r.place.knot];  // the time index was parked there
    // Bounded, so that the first rounds, far from the solution, do not overshoot.
    const double residual = std::clamp(r.target / std::exp(log_z) - 1, -0.9, 2.0);
    r.place = place_of_log_exposure(log_z);
    r.target = -residual;
    if (noise) r.weight /= 1 + residual * residual * r.weight / (cauchy_sigmas * cauchy_sigmas);
  }
}

void ResponseSolver::add_rows(const std::vector<Row>& rows, Normal& normal) const {
  double sum_w = 0, sum_wy = 0;
  for (const Row& r : rows) {
    sum_w += r.weight;
    sum_wy += r.weight * r.target;
  }
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const Row& p = rows[i];
    const std::size_t k = p.place.knot;
    const double lower_p = p.weight * (1 - p.place.upper), upper_p = p.weight * p.place.upper, centred = p.target - sum_wy / sum_w;
    normal.b[k] += lower_p * centred;
    normal.b[k + 1] += upper_p * centred;
    // The row itself, less its part in the elimination of the pixel's radiance.
    const double own = 1 / p.weight - 1 / sum_w;
    normal.add(k, k, lower_p * lower_p * own);
    normal.add(k + 1, k, lower_p * upper_p * own);
    normal.add(k + 1, k + 1, upper_p * upper_p * own);
    for (std::size_t j = 0; j < i; ++j) {
      const Row& q = rows[j];  // of a shorter exposure: its knot is not above k
      const std::size_t m = q.place.knot;
      const double lower_q = q.weight * (1 - q.place.upper) / sum_w, upper_q = q.weight * q.place.upper / sum_w;
      normal.add(k + 1, m, -upper_p * lower_q);
      if (k == m) {  // (k, k + 1) and (k + 1, k) are one entry of the lower triangle, the diagonal counts both orders
        normal.add(k, k, -2 * lower_p * lower_q);
        normal.add(k + 1, k, -lower_p * upper_q);
        normal.add(k + 1, k + 1, -2 * upper_p * upper_q);
      } else {
        normal.add(k, m, -lower_p * lower_q);
        normal.add(k, m + 1, (k == m + 1 ? -2 : -1) * lower_p * upper_q);
        normal.add(k + 1, m + 1, -upper_p * upper_q);
      }
    }
  }
}

/// Of h after the change: integral of h''^2 over s = log(v - black), and far weaker than any data |h| < 10 (the data say nothing about
/// its mean, which is the gauge, and with few levels hardly anything about its slope).
/// Structure of h finer than the noise of a value cannot be seen through that noise; left free, it would grow with every round. The
/// penalty outweighs the data (their information per s, I) at wavelengths below 2 pi L: strength I L^4, L = resolution * sigma_s.
void ResponseSolver::add_prior(const NoiseModel* noise, double slope_change, Normal& normal) const {
  constexpr double resolution = 1.5;
  const std::size_t n = knots_.size();
  const auto h = [&](std::size_t k) { return log_exposure_[k] - knots_[k]; };
  double largest = 0;
  for (std::size_t k = 0; k < n; ++k) {
    normal.information[k] = normal.a[k * n + k];
    largest = std::max(largest, normal.information[k]);
  }
  for (std::size_t k = 1; k + 1 < n; ++k) {
    const double below = knots_[k] - knots_[k - 1], above = knots_[k + 1] - knots_[k], span = (below + above) / 2;
    const double z = std::exp(log_exposure_[k]), slope = place_of_log_exposure(log_exposure_[k]).slope;
    const double length = std::min(resolution * std::sqrt(variance_at(z, slope, noise)) / slope / std::exp(knots_[k]), 0.5);
    const double d[3] = {1 / (below * span), -1 / (below * span) - 1 / (above * span), 1 / (above * span)};
    const double strength = span / (slope_change * slope_change) + normal.information[k] * std::pow(length, 4);
    const double second_derivative = d[0] * h(k - 1) + d[1] * h(k) + d[2] * h(k + 1);
    for (std::size_t p = 0; p < 3; ++p) {
      normal.b[k - 1 + p] -= strength * d[p] * second_derivative;
      for (std::size_t q = 0; q <= p; ++q) normal.add(k - 1 + p, k - 1 + q, strength * d[p] * d[q]);
    }
  }
  const double ridge = 0.01 / static_cast<double>(n) + 1e-12 * largest;  // the latter against rounding
  for (std::size_t k = 0; k < n; ++k) {
    normal.b[k] -= ridge * h(k);
    normal.add(k, k, ridge);
  }
}

double ResponseSolver::update(Normal& normal) {
  const std::size_t n = knots_.size();
  solve_cholesky(normal.a, normal.b);
  const std::vector<double> before = log_exposure_;
  // Gauge: mid-range stays. The data leave a constant open, so the solution may hold any.
  const double mid = std::log(std::exp2(bits_ - 1) - black_);
  const Place place = place_of_log_value(mid);
  const auto at_mid = [&](const std::vector<double>& y) { return (1 - place.upper) * y[place.knot] + place.upper * y[place.knot + 1]; };
  const double constant = at_mid(normal.b);
  // At most a factor e in one round: far from the solution the linearisation is not to be trusted further.
  for (std::size_t k = 0; k < n; ++k) log_exposure_[k] += std::clamp(normal.b[k] - constant, -1.0, 1.0);
  make_increasing(log_exposure_, 1e-7);
  const double shift = mid - at_mid(log_exposure_);
  double squares = 0, total = 0;
  for (std::size_t k = 0; k < n; ++k) {
    log_exposure_[k] += shift;
    squares += normal.information[k] * (log_exposure_[k] - before[k]) * (log_exposure_[k] - before[k]);
    total += normal.information[k];
  }
  return total > 0 ? std::sqrt(squares / total) : 0;
}

double ResponseSolver::refine(const NoiseModel* noise, double slope_change) {
  Normal normal(knots_.size());
  const std::vector<double> exposure = curve();
  std::vector<Row> rows;
  double squares = 0, weights = 0;
  for (std::size_t i = 0; i < pixels_.n_pixels(); ++i) {
    collect_rows(i, noise, exposure, rows);
    add_rows(rows, normal);
    for (const Row& r : rows) {
      squares += r.weight * r.target * r.target;
      weights += r.weight;
    }
  }
  residual_rms_ = weights > 0 ? std::sqrt(squares / weights) : 0;
  add_prior(noise, slope_change, normal);
  return update(normal);
}

std::vector<double> ResponseSolver::curve() const {
  const auto n = std::size_t{1} << bits_;
  const auto first = static_cast<std::size_t>(std::floor(black_)) + 1;
  std::vector<double> exposure(n);
  for (std::size_t v = first, k = 0; v < n; ++v) {
    const double s = std::log(static_cast<double>(v) - black_);
    while (k + 2 < knots_.size() && s > knots_[k + 1]) ++k;
    const double upper = (s - knots_[k]) / (knots_[k + 1] - knots_[k]);
    exposure[v] = std::exp((1 - upper) * log_exposure_[k] + upper * log_exposure_[k + 1]);
  }
  // Below: the straight line through (black, 0), so that noise around black keeps its sign.
  const double slope = exposure[first] / (static_cast<double>(first) - black_);
  for (std::size_t v = 0; v < first; ++v) exposure[v] = (static_cast<double>(v) - black_) * slope;
  return exposure;
}

}  // namespace lacquer::calib
