#include "bench/chain/coarse_table.h"

#include <cmath>
#include <numbers>

namespace lacquer::bench {

namespace {

using Grid = brdf::TableGrid;

struct Pool {
  double n = 0, mean = 0, variance = 0, theta_h = 0, theta_d = 0, phi_d = 0, along = 0, across = 0, mixed = 0, tangent = 0, tangent2 = 0;
};

/// Grid cells that group (h, d, p) covers.
template <typename Visit>
void each_cell(int n, int h, int d, int p, const Visit& visit) {
  for (int i = h * n; i < std::min((h + 1) * n, Grid::n_theta_h); ++i)
    for (int j = d * n; j < std::min((d + 1) * n, Grid::n_theta_d); ++j)
      for (int k = p * n; k < std::min((p + 1) * n, Grid::n_phi_d); ++k) visit(Grid::index(Grid::Cell{i, j, k}));
}

Pool pool(const brdf::TableChannel& t, int n, int h, int d, int p) {
  Pool sum;
  each_cell(n, h, d, p, [&](std::size_t i) {
    if (t.origin[i] != brdf::CellOrigin::measured) return;
    const double w = t.count[i], tangent = std::tan(static_cast<double>(t.theta_h[i]));
    sum.n += w, sum.mean += w * t.mean[i], sum.variance += w * w * t.variance[i];
    sum.theta_h += w * t.theta_h[i], sum.theta_d += w * t.theta_d[i], sum.phi_d += w * t.phi_d[i];
    sum.along += w * t.footprint_along[i], sum.across += w * t.footprint_across[i], sum.mixed += w * t.footprint_mixed[i];
    sum.tangent += w * tangent, sum.tangent2 += w * tangent * tangent;
  });
  return sum;
}

}  // namespace

brdf::HalfAngleTable coarser(const brdf::HalfAngleTable& table, int n) {
  brdf::HalfAngleTable result(table.channels.size());
  result.absolute_scale = table.absolute_scale;
  result.scale_sigma = table.scale_sigma;
  const auto groups = [n](int cells) { return (cells + n - 1) / n; };
  for (std::size_t c = 0; c < table.channels.size(); ++c)
    for (int h = 0; h < groups(Grid::n_theta_h); ++h)
      for (int d = 0; d < groups(Grid::n_theta_d); ++d)
        for (int p = 0; p < groups(Grid::n_phi_d); ++p) {
          const Pool s = pool(table.channels[c], n, h, d, p);
          if (!(s.n > 0)) continue;
          const auto mean = [&](double sum) { return static_cast<float>(sum / s.n); };
          brdf::TableChannel& t = result.channels[c];
          const std::size_t i = Grid::index(brdf::HalfDiff{s.theta_h / s.n, s.theta_d / s.n, s.phi_d / s.n});
          t.mean[i] = mean(s.mean);
          t.variance[i] = static_cast<float>(s.variance / (s.n * s.n));
          t.theta_h[i] = mean(s.theta_h), t.theta_d[i] = mean(s.theta_d), t.phi_d[i] = mean(s.phi_d);
          // As the table itself does within a cell: up to 20 degrees.
          const bool narrow = s.theta_h / s.n < 20 * std::numbers::pi / 180;
          t.footprint_along[i] = mean(s.along + (narrow ? std::max(0.0, s.tangent2 - s.tangent * s.tangent / s.n) : 0));
          t.footprint_across[i] = mean(s.across), t.footprint_mixed[i] = mean(s.mixed);
          t.count[i] = static_cast<std::uint32_t>(s.n);
          t.origin[i] = brdf::CellOrigin::measured;
        }
  return result;
}

}  // namespace lacquer::bench
