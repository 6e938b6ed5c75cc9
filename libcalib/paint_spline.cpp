#include "libcalib/paint_spline.h"

#include <algorithm>
#include <cmath>

namespace lacquer::calib {

namespace {

/// Quadratic B-splines of `n` on [0, n - 2]: the first of the three that are not 0 at x, and their values.
std::size_t quadratic(double x, std::size_t n, std::array<double, 3>& value) {
  const double last = static_cast<double>(n) - 3, cell = std::clamp(std::floor(x), 0.0, last), t = x - cell;
  value = {0.5 * (1 - t) * (1 - t), 0.5 + t * (1 - t), 0.5 * t * t};
  return static_cast<std::size_t>(cell);
}

}  // namespace

PaintSpline::PaintSpline(double lowest_theta_h, double highest_theta_h, double highest_theta_d)
    : lowest_(lowest_theta_h), highest_(highest_theta_h), root_lowest_(std::sqrt(lowest_theta_h)),
      per_root_((n_theta_h - 2.0) / (std::sqrt(highest_theta_h) - root_lowest_)), per_theta_d_((n_theta_d - 2.0) / highest_theta_d), highest_theta_d_(highest_theta_d) {}

bool PaintSpline::contains(const brdf::HalfDiff& c) const { return c.theta_h >= lowest_ && c.theta_h <= highest_ && c.theta_d <= highest_theta_d_; }

PaintSpline::Basis PaintSpline::at(const brdf::HalfDiff& c) const {
  std::array<double, 3> h, d, p;
  const double sine = std::sin(c.phi_d);
  const std::size_t ih = quadratic((std::sqrt(c.theta_h) - root_lowest_) * per_root_, n_theta_h, h);
  const std::size_t id = quadratic(c.theta_d * per_theta_d_, n_theta_d, d);
  const std::size_t ip = quadratic(sine * sine * (n_phi_d - 2.0), n_phi_d, p);
  Basis b;
  std::size_t k = 0;
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j)
      for (std::size_t l = 0; l < 3; ++l, ++k) {
        b.index[k] = ((ih + i) * n_theta_d + id + j) * n_phi_d + ip + l;
        b.value[k] = h[i] * d[j] * p[l];
      }
  return b;
}

void SplineMatrix::add(const PaintSpline::Basis& b, double weight) {
  for (std::size_t r = 0; r < PaintSpline::n_met; ++r) {
    const double w = weight * b.value[r];
    double* const row = &at(b.index[r], b.index[r]);
    for (std::size_t c = 0; c <= r; ++c) row[static_cast<std::ptrdiff_t>(b.index[c]) - static_cast<std::ptrdiff_t>(b.index[r])] += w * b.value[c];
  }
}

void SplineMatrix::add(const SplineMatrix& other) {
  for (std::size_t i = 0; i < a_.size(); ++i) a_[i] += other.a_[i];
}

void SplineMatrix::add_smoothness(double weight) {
  using S = PaintSpline;
  constexpr std::size_t stride[] = {S::n_theta_d * S::n_phi_d, S::n_phi_d, 1};
  constexpr std::size_t n[] = {S::n_theta_h, S::n_theta_d, S::n_phi_d};
  constexpr double second[] = {1, -2, 1};
  for (std::size_t i = 0; i < S::size; ++i) {
    at(i, i) += 1e-6 * weight;
    for (int axis = 0; axis < 3; ++axis) {
      if (i / stride[axis] % n[axis] + 2 >= n[axis]) continue;
      for (std::size_t r = 0; r < 3; ++r)
        for (std::size_t c = 0; c <= r; ++c) at(i + r * stride[axis], i + c * stride[axis]) += weight * second[r] * second[c];
    }
  }
}

void SplineMatrix::factor() {
  for (std::size_t i = 0; i < PaintSpline::size; ++i) {
    const std::size_t first = i > PaintSpline::band ? i - PaintSpline::band : 0;
    for (std::size_t j = first; j <= i; ++j) {
      const std::size_t from = std::max(first, j > PaintSpline::band ? j - PaintSpline::band : 0);
      const double *const x = &a_[i * width + from + PaintSpline::band - i], *const y = &a_[j * width + from + PaintSpline::band - j];
      double sum[4] = {0, 0, 0, 0};
      const std::size_t n = j - from;
      std::size_t k = 0;
      for (; k + 4 <= n; k += 4)
        for (std::size_t l = 0; l < 4; ++l) sum[l] += x[k + l] * y[k + l];
      for (; k < n; ++k) sum[0] += x[k] * y[k];
      const double rest = at(i, j) - ((sum[0] + sum[1]) + (sum[2] + sum[3]));
      at(i, j) = i == j ? std::sqrt(rest) : rest / at(j, j);
    }
  }
}

void SplineMatrix::solve_lower(std::vector<double>& b) const {
  for (std::size_t i = 0; i < PaintSpline::size; ++i) {
    double sum = b[i];
    for (std::size_t j = i > PaintSpline::band ? i - PaintSpline::band : 0; j < i; ++j) sum -= at(i, j) * b[j];
    b[i] = sum / at(i, i);
  }
}

void SplineMatrix::solve_upper(std::vector<double>& b) const {
  for (std::size_t i = PaintSpline::size; i-- > 0;) {
    b[i] /= at(i, i);
    for (std::size_t j = i > PaintSpline::band ? i - PaintSpline::band : 0; j < i; ++j) b[j] -= at(i, j) * b[i];
  }
}

}  // namespace lacquer::calib
