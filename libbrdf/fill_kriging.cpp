#include "libbrdf/fill_kriging.h"

#include <cmath>

namespace lacquer::brdf {

namespace {

/// Covariance of the logarithm after the rows' means were taken off. The absolute size matters little, cross-validation sets the variance.
constexpr double amplitude = 0.15;                                   // of what the drifts do not explain
constexpr double mean_sigma = 3, slope_h = 0.3, slope_d = 0.1, slope_q = 1;  // prior sigmas of the drifts: constant, per cell, per deg, per unit
constexpr double length_h = 4, length_d = 8, length_p = 6;           // cells, degrees, degrees times sin(theta_h) sin(theta_d)
constexpr double nugget = 1e-4;                                      // of the logarithm: what no smooth function follows

}  // namespace

Kriging::Kriging(const TableChannel& channel) : data_(channel), cosines_(FoldedChannel::n_cells) {
  for (int h = 0; h < FoldedChannel::n_h; ++h)
    for (int d = 0; d < FoldedChannel::n_d; ++d)
      for (int p = 0; p < FoldedChannel::n_p; ++p) {
        const auto c = half_angle_cosines(TableGrid::centre(TableGrid::Cell{h, d, p}));
        cosines_[FoldedChannel::index({h, d, p})] = static_cast<float>(std::log(std::max(c.n_dot_i, 0.02)) + std::log(std::max(c.n_dot_o, 0.02)));
      }
}

FillPattern Kriging::pattern(const Place& hole) const {
  constexpr std::array<int, 4> reach{0, 40, 20, 12};  // by the number of axes that change
  FillPattern found;
  for (int dh = -1; dh <= 1; ++dh)
    for (int dd = -1; dd <= 1; ++dd)
      for (int dp = -1; dp <= 1; ++dp) {
        const int axes = std::abs(dh) + std::abs(dd) + std::abs(dp);
        int wanted = axes == 1 ? 2 : 1;
        for (int k = 1; axes > 0 && wanted > 0 && k <= reach[static_cast<std::size_t>(axes)]; ++k) {
          const Place offset{k * dh, k * dd, k * dp};
          if (!FoldedChannel::inside(hole.h + offset.h, hole.d + offset.d)) break;
          if (!known({hole.h + offset.h, hole.d + offset.d, hole.p + offset.p})) continue;
          found.offset[static_cast<std::size_t>(found.n++)] = offset;
          --wanted;
        }
      }
  return found;
}

std::optional<Kriging::Prediction> Kriging::predict(const Place& at, const FillPattern& pattern, double length_scale) const {
  std::array<Point, FillPattern::max_neighbours> points;
  int n = 0, nearest = 1000;
  const HalfDiff centre = TableGrid::centre(TableGrid::Cell{at.h, at.d, FoldedChannel::fold(at.p)});
  const double turn = std::max(0.05, std::sin(centre.theta_h) * std::sin(centre.theta_d));
  const double q = cosines_[FoldedChannel::index(at)];
  for (int k = 0; k < pattern.n; ++k) {
    const Place& o = pattern.offset[static_cast<std::size_t>(k)];
    const Place c{at.h + o.h, at.d + o.d, at.p + o.p};
    if (!known(c)) continue;
    const std::size_t i = FoldedChannel::index(c);
    nearest = std::min(nearest, std::max({std::abs(o.h), std::abs(o.d), std::abs(o.p)}));
    points[static_cast<std::size_t>(n++)] = {o.h / length_h, o.d / length_d, o.p * turn / length_p, slope_h * o.h, slope_d * o.d,
                                             slope_q * (cosines_[i] - q), data_.log(i), data_.variance(i)};
  }
  if (n < 4) return std::nullopt;
  Prediction result = krige(points.data(), n, 1 / length_scale, data_.row_mean(at.h));
  result.gap = gap_class(nearest);
  return result;
}

/// Simple kriging at the origin; the drifts are part of the covariance.
Kriging::Prediction Kriging::krige(const Point* points, int n, double inverse_scale, double row_mean) {
  const auto matern = [&](double dh, double dd, double dp) {
    const double r = std::sqrt(5 * (dh * dh + dd * dd + dp * dp)) * inverse_scale;
    return amplitude * amplitude * (1 + r + r * r / 3) * std::exp(-r);
  };
  constexpr int max_neighbours = FillPattern::max_neighbours;
  double l[max_neighbours][max_neighbours], y[max_neighbours], k[max_neighbours];
  for (int i = 0; i < n; ++i) {
    const Point& a = points[i];
    for (int j = 0; j <= i; ++j) {
      const Point& b = points[j];
      l[i][j] = matern(a.h - b.h, a.d - b.d, a.p - b.p) + mean_sigma * mean_sigma + a.drift_h * b.drift_h + a.drift_d * b.drift_d +
                a.drift_q * b.drift_q;
    }
    l[i][i] += a.variance + nugget * nugget;
    y[i] = a.value;
    k[i] = matern(a.h, a.d, a.p) + mean_sigma * mean_sigma;
  }
  double mean = 0, variance = amplitude * amplitude + mean_sigma * mean_sigma;
  for (int i = 0; i < n; ++i) {  // Cholesky; y and k are solved along
    for (int j = 0; j < i; ++j) {
      double sum = l[i][j];
      for (int m = 0; m < j; ++m) sum -= l[i][m] * l[j][m];
      l[i][j] = sum / l[j][j];
    }
    double diagonal = l[i][i];
    for (int m = 0; m < i; ++m) diagonal -= l[i][m] * l[i][m], y[i] -= l[i][m] * y[m], k[i] -= l[i][m] * k[m];
    l[i][i] = std::sqrt(std::max(diagonal, nugget * nugget / 2));
    y[i] /= l[i][i];
    k[i] /= l[i][i];
    mean += y[i] * k[i];
    variance -= k[i] * k[i];
  }
  return {mean + row_mean, std::max(variance, nugget * nugget), 0};
}

}  // namespace lacquer::brdf
