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
    : cross(n_columns, std::vector<double>(PaintSpline::size)), columns(n_columns), residual(n_columns), view_cross(2 * n_views, std::vector<double>(PaintSpline::size)),
      view_weight(n_views), view_residual(2 * n_views), view_columns(n_columns, std::vector<double>(2 * n_views)) {}

void PaintSums::add(const PaintSpline::Basis& b, const std::vector<double>& d, std::size_t view, double by_angle, double w, double r) {
  const std::size_t angle = view_weight.size() + view;
  paint.add(b, w);
  for (std::size_t k = 0; k < PaintSpline::n_met; ++k) {
    const double value = w * b.value[k];
    paint_residual[b.index[k]] += r * value;
    view_cross[view][b.index[k]] += value;
    view_cross[angle][b.index[k]] += by_angle * value;
  }
  for (std::size_t c = 0; c < d.size(); ++c) {
    if (d[c] == 0) continue;  // another light's
    const double value = w * d[c];
    for (std::size_t k = 0; k < PaintSpline::n_met; ++k) cross[c][b.index[k]] += value * b.value[k];
    for (std::size_t e = 0; e <= c; ++e) columns.at(c, e) += value * d[e];
    residual[c] += value * r;
    view_columns[c][view] += value;
    view_columns[c][angle] += value * by_angle;
  }
  view_weight[view][0] += w;
  view_weight[view][1] += w * by_angle;
  view_weight[view][2] += w * by_angle * by_angle;
  view_residual[view] += w * r;
  view_residual[angle] += w * by_angle * r;
}

void PaintSums::add_track(const std::vector<double>& d, std::size_t view, double w, double r) {
  const std::size_t angle = view_weight.size() + view;
  for (std::size_t c = 0; c < d.size(); ++c) {
    for (std::size_t e = 0; e <= c; ++e) columns.at(c, e) += w * d[c] * d[e];
    residual[c] += w * d[c] * r;
    view_columns[c][angle] += w * d[c];
  }
  view_weight[view][2] += w;
  view_residual[angle] += w * r;
}

void PaintSums::add(const PaintSums& o) {
  paint.add(o.paint);
  add_to(paint_residual, o.paint_residual);
  columns.add(o.columns);
  add_to(residual, o.residual);
  add_to(view_residual, o.view_residual);
  for (std::size_t c = 0; c < cross.size(); ++c) {
    add_to(cross[c], o.cross[c]);
    add_to(view_columns[c], o.view_columns[c]);
  }
  for (std::size_t v = 0; v < view_cross.size(); ++v) add_to(view_cross[v], o.view_cross[v]);
  for (std::size_t v = 0; v < view_weight.size(); ++v)
    for (std::size_t k = 0; k < 3; ++k) view_weight[v][k] += o.view_weight[v][k];
}

PaintElimination::PaintElimination(PaintSums sums, double smoothness, const std::vector<double>& prior_sigma, double angle_sigma) : n_views_(sums.view_weight.size()) {
  constexpr double exact = 1e-9;  // radians
  angle_sigma = std::max(angle_sigma, exact);
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
      h[v] -= dot(u[v], z);
    }
  });
  for (std::size_t v = 0; v < n_views_; ++v) {
    views.at(v, v) += sums.view_weight[v][0];
    views.at(n_views_ + v, v) += sums.view_weight[v][1];
    views.at(n_views_ + v, n_views_ + v) += sums.view_weight[v][2];
  }
  find_view_sigma(views, x, h, prior_sigma, angle_sigma);

  // Then the views'.
  const auto precision = [&](std::size_t v) { return std::pow(v < n_views_ ? view_sigma_ : angle_sigma, -2); };
  Columns taken = x;
  taken.push_back(h);
  view_taken_ = solve_columns(with_diagonal(std::move(views), precision), std::move(taken));
  view_step_ = std::move(view_taken_.back());
  view_taken_.pop_back();
  in_parallel(n, [&](std::size_t c) {
    for (std::size_t e = 0; e <= c; ++e) s_.at(c, e) -= dot(x[e], view_taken_[c]);
    g_[c] -= dot(x[c], view_step_);
  });
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
                                       const std::vector<double>& prior_sigma, double angle_sigma) {
  // Of the views' factors alone: without the columns and the angles, which have priors.
  const std::size_t n = cross.size(), m = n_views_;
  SymmetricMatrix others(n + m);
  Columns share(m + 1, std::vector<double>(n + m));
  for (std::size_t r = 0; r < n + m; ++r) {
    for (std::size_t c = 0; c <= r; ++c) others.at(r, c) = r < n ? s_(r, c) : c < n ? cross[c][m + r - n] : views(m + r - n, m + c - n);
    others.at(r, r) += std::pow(r < n ? prior_sigma[r] : angle_sigma, -2);
    for (std::size_t v = 0; v < m; ++v) share[v][r] = r < n ? cross[r][v] : views(m + r - n, v);
    share[m][r] = r < n ? g_[r] : view_gradient[m + r - n];
  }
  const Columns solved = solve_columns(std::move(others), share);
  std::vector<double> gradient(m);
  cv::Mat k(static_cast<int>(m), static_cast<int>(m), CV_64F);
  in_parallel(m, [&](std::size_t v) {
    gradient[v] = view_gradient[v] - dot(share[v], solved[m]);
    for (std::size_t w = 0; w < m; ++w) k.at<double>(static_cast<int>(v), static_cast<int>(w)) = views(v, w) - dot(share[v], solved[w]);
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

double PaintElimination::project(const PaintSpline::Basis& b, std::size_t view, double by_angle, double residual, std::vector<double>& d) const {
  const std::size_t angle = n_views_ + view;
  double r = residual - view_step_[view] - by_angle * view_step_[angle];
  for (std::size_t k = 0; k < PaintSpline::n_met; ++k) r -= b.value[k] * paint_step_[b.index[k]];
  for (std::size_t c = 0; c < d.size(); ++c) {
    double sum = view_taken_[c][view] + by_angle * view_taken_[c][angle];
    for (std::size_t k = 0; k < PaintSpline::n_met; ++k) sum += b.value[k] * taken_[c][b.index[k]];
    d[c] -= sum;
    r -= d[c] * step_[c];
  }
  return r;
}

double PaintElimination::project_track(std::size_t view, double residual, std::vector<double>& d) const {
  const std::size_t angle = n_views_ + view;
  double r = residual - view_step_[angle];
  for (std::size_t c = 0; c < d.size(); ++c) {
    d[c] -= view_taken_[c][angle];
    r -= d[c] * step_[c];
  }
  return r;
}

void add_rows(const PaintElimination& elimination, const SymmetricMatrix& scatter, const std::vector<double>& nuisance_sigma, const std::vector<double>& at,
              GeometryEvidence& evidence) {
  const SymmetricMatrix& s = elimination.information();
  const std::size_t n_all = s.size(), n = at.size(), m = nuisance_sigma.size();
  // Information that the scatter supports: S M^-1 S, and the gradient with it.
  Columns s_columns(n_all, std::vector<double>(n_all));
  for (std::size_t k = 0; k < n_all; ++k)
    for (std::size_t r = 0; r < n_all; ++r) s_columns[k][r] = s(r, k);
  const Columns m_s = solve_columns(scatter, s_columns);
  SymmetricMatrix full(n_all);
  std::vector<double> gradient(n_all);
  in_parallel(n_all, [&](std::size_t r) {
    for (std::size_t c = 0; c <= r; ++c) full.at(r, c) = dot(m_s[r], s_columns[c]);
    gradient[r] = dot(m_s[r], elimination.gradient());
  });
  // Without the nuisances.
  SymmetricMatrix own(m);
  Columns share(n + 1, std::vector<double>(m));
  for (std::size_t r = 0; r < m; ++r) {
    for (std::size_t c = 0; c <= r; ++c) own.at(r, c) = full(n + r, n + c);
    own.at(r, r) += std::pow(nuisance_sigma[r], -2);
    for (std::size_t k = 0; k < n; ++k) share[k][r] = full(n + r, k);
    share[n][r] = gradient[n + r];
  }
  const Columns solved = solve_columns(std::move(own), share);
  cv::Mat information(static_cast<int>(n), static_cast<int>(n), CV_64F), values, vectors;
  for (std::size_t r = 0; r < n; ++r) {
    for (std::size_t c = 0; c <= r; ++c)
      information.at<double>(static_cast<int>(r), static_cast<int>(c)) = information.at<double>(static_cast<int>(c), static_cast<int>(r)) = full(r, c) - dot(share[r], solved[c]);
    gradient[r] -= dot(share[r], solved[n]);
  }
  cv::eigen(information, values, vectors);
  for (int k = 0; k < static_cast<int>(n); ++k) {
    const double root = std::sqrt(std::max(0.0, values.at<double>(k)));
    constexpr double nothing = 1e-3;  // of the prior's information: 1e-6
    if (!(root > nothing)) continue;
    std::vector<double> row(n);
    double offset = 0;
    for (std::size_t i = 0; i < n; ++i) {
      const double v = vectors.at<double>(k, static_cast<int>(i));
      row[i] = root * v;
      offset += v * gradient[i] / root + row[i] * at[i];
    }
    evidence.rows.push_back(std::move(row));
    evidence.offset.push_back(offset);
  }
}

}  // namespace lacquer::calib
