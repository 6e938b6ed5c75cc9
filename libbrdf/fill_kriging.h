#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdlib>
#include <optional>
#include <vector>

#include "libbrdf/folded_channel.h"

/// Interpolation of one hole; see fill_table.h.
namespace lacquer::brdf {

/// Where the data around a hole lie, relative to it.
struct FillPattern {
  using Place = FoldedChannel::Place;
  static constexpr int max_neighbours = 32;
  int n = 0;
  std::array<Place, max_neighbours> offset;

  /// Cells to the nearest one.
  int nearest() const {
    int cells = 1000;
    for (int k = 0; k < n; ++k) {
      const Place& o = offset[static_cast<std::size_t>(k)];
      cells = std::min(cells, std::max({std::abs(o.h), std::abs(o.d), std::abs(o.p)}));
    }
    return cells;
  }
};

/// 0: data in the next cell but one, 1: up to five cells away, 2: a wide gap.
constexpr std::size_t n_gaps = 3;
inline std::size_t gap_class(int cells_to_nearest) { return cells_to_nearest <= 2 ? 0 : cells_to_nearest <= 5 ? 1 : 2; }

/// A Gaussian process through the logarithms of a channel's known cells. The absolute size of its variance matters little.
class Kriging {
 public:
  using Place = FoldedChannel::Place;
  struct Prediction {
    double log, variance;
    std::size_t gap;  // class
  };
  static constexpr std::array<double, 4> length_scales{0.5, 1, 2, 4};  ///< to choose from

  explicit Kriging(const TableChannel& channel);
  const FoldedChannel& data() const { return data_; }
  double log_cosines(const Place& c) const { return cosines_[FoldedChannel::index(c)]; }
  bool known(const Place& c) const { return FoldedChannel::inside(c.h, c.d) && data_.known(FoldedChannel::index(c)); }

  /// The nearest known cells along 26 directions, along the axes the two nearest.
  FillPattern pattern(const Place& hole) const;
  /// From those cells of the pattern that are known; nullopt with fewer than four of them.
  std::optional<Prediction> predict(const Place& at, const FillPattern& pattern, double length_scale) const;

 private:
  struct Point {
    double h, d, p, drift_h, drift_d, drift_q, value, variance;
  };
  static Prediction krige(const Point* points, int n, double inverse_scale, double row_mean);

  FoldedChannel data_;
  std::vector<float> cosines_;  // ln(cos(theta_i) cos(theta_o)) at the cells' centres
};

}  // namespace lacquer::brdf
