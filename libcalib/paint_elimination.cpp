#include "libcalib/paint_elimination.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

namespace lacquer::calib {

namespace {

double dot(const std::vector<double>& a, const std::vector<double>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}

void add_to(std::vector<double>& a, const std::vector<double>& b, double factor = 1) {
  for (std::size_t i = 0; i < a.size(); ++i) a[i] += factor * b[i];
}

SymmetricMatrix with_diagonal(SymmetricMatrix a, const auto& diagonal) {
  for (std::size_t k = 0; k < a.size(); ++k) a.at(k, k) += diagonal(k);
  return a;
}

template <typename Body>
void in_parallel(std::size_t n, const Body& body) {
  tbb::parallel_for(std::size_t{0}, n, body);
}

}  // namespace

PaintSums::PaintSums(std::size_t n_columns, std::size_t n_views)
    : cross(n_columns, std::vector<double>(PaintSpline::size)), columns(n_columns), residual(n_columns), view_cross(n_views, std::vector<double>(PaintSpline::size)),
      view_weight(n_views), view_residual(n_views), view_columns(n_columns, std::vector<double>(n_views)) {}

void PaintSums::add(const PaintSpline::Basis& b, const std::vector<double>& d, std::size_t view, double w, double r) {
  paint.add(b, w);
  for (std::size_t k = 0; k < PaintSpline::n_met; ++k) {
    paint_residual[b.index[k]] += w * r * b.value[k];
    view_cross[view][b.index[k]] += w * b.value[k];
  }
  for (std::size_t c = 0; c < d.size(); ++c) {
    for (std::size_t k = 0; k < PaintSpline::n_met; ++k) cross[c][b.index[k]] += w * d[c] * b.value[k];
    for (std::size_t e = 0; e <= c; ++e) columns.at(c, e) += w * d[c] * d[e];
    residual[c] += w * d[c] * r;
    view_columns[c][view] += w * d[c];
  }
  view_weight[view] += w;
  view_residual[view] += w * r;
}

void PaintSums::add(const PaintSums& o) {
  paint.add(o.paint);
  add_to(paint_residual, o.paint_residual);
  columns.add(o.columns);
  add_to(residual, o.residual);
  add_to(view_weight, o.view_weight);
  add_to(view_residual, o.view_residual);
  for (std::size_t c = 0; c < cross.size(); ++c) {
    add_to(cross[c], o.cross[c]);
    add_to(view_columns[c], o.view_columns[c]);
  }
  for (std::size_t v = 0; v < view_cross.size(); ++v) add_to(view_cross[v], o.view_cross[v]);
}

PaintElimination::PaintElimination(PaintSums sums, double smoothness, const std::vector<double>& prior_sigma) {
  const std::size_t n = sums.cross.size(), m = sums.view_cross.size();
  sums.paint.add_smoothness(smoothness);
  sums.paint.factor();
  // The paint's share, by L^-1 of its matrix.
  std::vector<double>& z = sums.paint_residual;
  sums.paint.solve_lower(z);
  Columns &y = sums.cross, &u = sums.view_cross;
  in_parallel(n + m, [&](std::size_t k) { sums.paint.solve_lower(k < n ? y[k] : u[k - n]); });
  s_ = std::move(sums.columns);
  g_ = std::move(sums.residual);
  Columns& x = sums.view_columns;
  std::vector<double>& h = sums.view_residual;
  SymmetricMatrix views(m);
  in_parallel(n + m, [&](std::size_t k) {
    if (k < n) {
      for (std::size_t c = 0; c <= k; ++c) s_.at(k, c) -= dot(y[k], y[c]);
      for (std::size_t v = 0; v < m; ++v) x[k][v] -= dot(y[k], u[v]);
      g_[k] -= dot(y[k], z);
    } else {
      const std::size_t v = k - n;
      for (std::size_t w = 0; w <= v; ++w) views.at(v, w) = -dot(u[v], u[w]);
      views.at(v, v) += sums.view_weight[v];
      h[v] -= dot(u[v], z);
    }
  });
  find_view_sigma(views, x, h, prior_sigma);

  // Then the views'.
  const SymmetricMatrix with_prior = with_diagonal(std::move(views), [&](std::size_t) { return 1 / (view_sigma_ * view_sigma_); });
  view_step_ = solve(with_prior, h);
  view_taken_ = x;
  in_parallel(n, [&](std::size_t c) { view_taken_[c] = solve(with_prior, x[c]); });
  for (std::size_t c = 0; c < n; ++c) {
    for (std::size_t e = 0; e <= c; ++e) s_.at(c, e) -= dot(x[e], view_taken_[c]);
    g_[c] -= dot(x[c], view_step_);
  }
  taken_ = std::move(y);
  in_parallel(n + 1, [&](std::size_t c) {
    std::vector<double>& paint = c < n ? taken_[c] : z;
    const std::vector<double>& of_views = c < n ? view_taken_[c] : view_step_;
    for (std::size_t v = 0; v < m; ++v) add_to(paint, u[v], -of_views[v]);
    sums.paint.solve_upper(paint);
  });
  paint_step_ = std::move(z);
  step_ = solve(with_diagonal(s_, [&](std::size_t k) { return 1 / (prior_sigma[k] * prior_sigma[k]); }), g_);
}

void PaintElimination::find_view_sigma(const SymmetricMatrix& views, const Columns& cross, const std::vector<double>& view_gradient,
                                       const std::vector<double>& prior_sigma) {
  const std::size_t n = cross.size(), m = view_gradient.size();
  // Of the views' factors alone: without the columns, which have priors.
  const SymmetricMatrix with_priors = with_diagonal(s_, [&](std::size_t k) { return 1 / (prior_sigma[k] * prior_sigma[k]); });
  std::vector<double> gradient = view_gradient;
  const std::vector<double> step = solve(with_priors, g_);
  for (std::size_t c = 0; c < n; ++c) add_to(gradient, cross[c], -step[c]);
  cv::Mat k(static_cast<int>(m), static_cast<int>(m), CV_64F);
  in_parallel(m, [&](std::size_t v) {
    std::vector<double> column(n);
    for (std::size_t c = 0; c < n; ++c) column[c] = cross[c][v];
    const std::vector<double> share = solve(with_priors, column);
    for (std::size_t w = 0; w < m; ++w) {
      double sum = views(v, w);
      for (std::size_t c = 0; c < n; ++c) sum -= share[c] * cross[c][w];
      k.at<double>(static_cast<int>(v), static_cast<int>(w)) = sum;
    }
  });
  cv::Mat values, vectors;
  cv::eigen(k, values, vectors);
  std::vector<double> along(m);  // the gradient along the eigenvectors
  for (std::size_t i = 0; i < m; ++i)
    for (std::size_t v = 0; v < m; ++v) along[i] += vectors.at<double>(static_cast<int>(i), static_cast<int>(v)) * gradient[v];
  constexpr double first = 1e-3, least = 1e-4;
  constexpr int iterations = 50;
  view_sigma_ = first;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    double sum = 0;
    for (std::size_t i = 0; i < m; ++i) {
      const double variance = 1 / (std::max(0.0, values.at<double>(static_cast<int>(i))) + 1 / (view_sigma_ * view_sigma_));
      sum += variance + std::pow(variance * along[i], 2);
    }
    view_sigma_ = std::max(least, std::sqrt(sum / static_cast<double>(m)));
  }
}

double PaintElimination::project(const PaintSpline::Basis& b, std::size_t view, double residual, std::vector<double>& d) const {
  double r = residual - view_step_[view];
  for (std::size_t k = 0; k < PaintSpline::n_met; ++k) r -= b.value[k] * paint_step_[b.index[k]];
  for (std::size_t c = 0; c < d.size(); ++c) {
    d[c] -= view_taken_[c][view];
    for (std::size_t k = 0; k < PaintSpline::n_met; ++k) d[c] -= b.value[k] * taken_[c][b.index[k]];
    r -= d[c] * step_[c];
  }
  return r;
}

}  // namespace lacquer::calib
