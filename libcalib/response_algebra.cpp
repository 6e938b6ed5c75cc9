#include "libcalib/response_algebra.h"

#include <algorithm>
#include <cmath>
#include <tbb/parallel_for.h>

namespace lacquer::calib {

namespace {

/// Four sums side by side, which a compiler without fast-math would not make of one.
double dot(const double* x, const double* y, std::size_t n) {
  double sum[4] = {0, 0, 0, 0};
  std::size_t i = 0;
  for (; i + 4 <= n; i += 4)
    for (std::size_t k = 0; k < 4; ++k) sum[k] += x[i + k] * y[i + k];
  for (; i < n; ++i) sum[0] += x[i] * y[i];
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/// Scales to a unit diagonal and factors in place, L L^T. Returns the scales; an open unknown has scale 0 and a row that changes nothing.
std::vector<double> factor(SymmetricMatrix& a) {
  constexpr double open = 1e-13;
  const std::size_t n = a.size();
  std::vector<double> scale(n);
  for (std::size_t i = 0; i < n; ++i) scale[i] = a(i, i) > 0 ? 1 / std::sqrt(a(i, i)) : 0;
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j <= i; ++j) a.at(i, j) *= scale[i] * scale[j];
  for (std::size_t i = 0; i < n; ++i) {
    double* const row = a.row(i);
    for (std::size_t j = 0; j < i; ++j) row[j] = scale[j] > 0 ? (row[j] - dot(row, a.row(j), j)) / a(j, j) : 0;
    const double pivot = row[i] - dot(row, row, i);
    if (pivot > open) {
      row[i] = std::sqrt(pivot);
    } else {
      scale[i] = 0;
      std::fill(row, row + i, 0.0);
      row[i] = 1;
    }
  }
  return scale;
}

/// In place, b becomes the solution: L and scales as factor() leaves them.
void substitute(const SymmetricMatrix& l, const std::vector<double>& scale, std::vector<double>& b) {
  const std::size_t n = l.size();
  for (std::size_t i = 0; i < n; ++i) b[i] = (b[i] * scale[i] - dot(l.row(i), b.data(), i)) / l(i, i);
  for (std::size_t i = n; i-- > 0;) {
    const double* const row = l.row(i);
    b[i] /= row[i];
    for (std::size_t j = 0; j < i; ++j) b[j] -= row[j] * b[i];
  }
  for (std::size_t i = 0; i < n; ++i) b[i] *= scale[i];
}

/// L^-1 diag(scale), lower triangle.
SymmetricMatrix inverse_factor(const SymmetricMatrix& l, const std::vector<double>& scale) {
  const std::size_t n = l.size();
  SymmetricMatrix inverse(n);
  // By columns, each stored as a contiguous run of its own.
  tbb::parallel_for(std::size_t{0}, n, [&](std::size_t j) {
    std::vector<double> column(n - j);
    column[0] = scale[j] / l(j, j);
    for (std::size_t i = j + 1; i < n; ++i) column[i - j] = -dot(l.row(i) + j, column.data(), i - j) / l(i, i);
    for (std::size_t i = j; i < n; ++i) inverse.at(i, j) = column[i - j];
  });
  return inverse;
}

}  // namespace

void SymmetricMatrix::add(const SymmetricMatrix& other) {
  for (std::size_t i = 0; i < a_.size(); ++i) a_[i] += other.a_[i];
}

void SymmetricMatrix::scale(double factor) {
  for (double& x : a_) x *= factor;
}

double SymmetricMatrix::quadratic_form(std::size_t first, const std::vector<double>& x) const {
  double sum = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    const double* const entries = row(first + i) + first;
    sum += x[i] * (2 * dot(entries, x.data(), i) + entries[i] * x[i]);
  }
  return sum;
}

std::vector<double> solve(SymmetricMatrix a, std::vector<double> b) {
  const std::vector<double> scale = factor(a);
  substitute(a, scale, b);
  return b;
}

std::vector<std::vector<double>> solve_columns(SymmetricMatrix a, std::vector<std::vector<double>> b) {
  const std::vector<double> scale = factor(a);
  tbb::parallel_for(std::size_t{0}, b.size(), [&](std::size_t k) { substitute(a, scale, b[k]); });
  return b;
}

std::vector<double> cholesky_factor(const std::vector<double>& covariance, std::size_t n) {
  std::vector<double> l(n * n);
  for (std::size_t j = 0; j < n; ++j) {
    double pivot = covariance[j * n + j];
    for (std::size_t k = 0; k < j; ++k) pivot -= l[j * n + k] * l[j * n + k];
    if (!(pivot > 1e-12 * covariance[j * n + j])) continue;
    l[j * n + j] = std::sqrt(pivot);
    for (std::size_t i = j + 1; i < n; ++i) {
      double sum = covariance[i * n + j];
      for (std::size_t k = 0; k < j; ++k) sum -= l[i * n + k] * l[j * n + k];
      l[i * n + j] = sum / l[j * n + j];
    }
  }
  return l;
}

SymmetricMatrix sandwich(SymmetricMatrix a, const SymmetricMatrix& s) {
  const std::size_t n = a.size();
  const std::vector<double> scale = factor(a);
  const SymmetricMatrix k = inverse_factor(a, scale);  // A^-1 = K^T K
  std::vector<double> inverse(n * n), full(n * n), half(n * n), result(n * n);
  std::vector<double> columns(n * n);  // column j of K as row j, 0 above the diagonal
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j) {
      columns[j * n + i] = i >= j ? k(i, j) : 0;
      full[i * n + j] = s(i, j);
    }
  const auto multiply = [&](const std::vector<double>& x, const std::vector<double>& y, std::vector<double>& xy_transposed) {
    tbb::parallel_for(std::size_t{0}, n, [&](std::size_t i) {
      for (std::size_t j = 0; j < n; ++j) xy_transposed[i * n + j] = dot(&x[i * n], &y[j * n], n);
    });
  };
  multiply(columns, columns, inverse);
  multiply(inverse, full, half);
  multiply(half, inverse, result);
  SymmetricMatrix covariance(n);
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j <= i; ++j) covariance.at(i, j) = result[i * n + j];
  return covariance;
}

}  // namespace lacquer::calib
