#include "libbrdf/folded_channel.h"

#include <cmath>

namespace lacquer::brdf {

namespace {

/// Adds the logarithm of one measured cell, weighted by its certainty; an exact value (variance 0) counts as known to 1e-4.
struct WeightedLog {
  double weight = 0, sum = 0;
  void add(const TableChannel& t, std::size_t i) {
    if (t.origin[i] != CellOrigin::measured || !(t.mean[i] > 0) || !std::isfinite(t.variance[i])) return;
    const double mean = t.mean[i], relative2 = t.variance[i] / (mean * mean);
    if (!(relative2 < 0.25)) return;
    const double w = 1 / (relative2 + 1e-8);
    weight += w;
    sum += w * std::log(mean);
  }
};

}  // namespace

FoldedChannel::FoldedChannel(const TableChannel& t) : log_(n_cells), variance_(n_cells, -1.0f) {
  std::array<double, n_h> sum{};
  std::array<std::size_t, n_h> count{};
  for (int h = 0; h < n_h; ++h)
    for (int d = 0; d < n_d; ++d)
      for (int p = 0; p < n_p; ++p) {
        const std::size_t cell = TableGrid::index(TableGrid::Cell{h, d, p}), i = index({h, d, p});
        WeightedLog both;
        both.add(t, cell);
        both.add(t, TableGrid::mirror(cell));
        if (both.weight == 0) continue;
        log_[i] = static_cast<float>(both.sum / both.weight);
        variance_[i] = static_cast<float>(1 / both.weight);
        sum[static_cast<std::size_t>(h)] += log_[i];
        ++count[static_cast<std::size_t>(h)];
        ++n_known_;
      }
  for (int h = 0; h < n_h && n_known_ > 0; ++h) {
    // A row without data takes the nearest one's mean.
    for (int away = 0; away < n_h; ++away)
      if (const int row = h - away >= 0 && count[static_cast<std::size_t>(h - away)] ? h - away : h + away;
          row < n_h && count[static_cast<std::size_t>(row)]) {
        row_mean_[static_cast<std::size_t>(h)] = sum[static_cast<std::size_t>(row)] / static_cast<double>(count[static_cast<std::size_t>(row)]);
        break;
      }
  }
  for (std::size_t i = 0; i < n_cells; ++i)
    if (known(i)) log_[i] -= static_cast<float>(row_mean_[i / (std::size_t{n_d} * n_p)]);
}

}  // namespace lacquer::brdf
