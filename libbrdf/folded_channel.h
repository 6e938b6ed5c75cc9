#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "libbrdf/table.h"

namespace lacquer::brdf {

/// Logarithms of a channel's measured cells, phi_d and pi - phi_d taken as one cell: what hole filling works on.
class FoldedChannel {
 public:
  static constexpr int n_h = TableGrid::n_theta_h, n_d = TableGrid::n_theta_d, n_p = TableGrid::n_phi_d / 2;

  /// Cells of which neither half is known to two of its sigmas have no logarithm and are no data.
  explicit FoldedChannel(const TableChannel& channel);

  struct Place {
    int h, d, p;  ///< p also outside [0, n_p): mirrored there
  };
  static int fold(int p) {
    p = ((p % (2 * n_p)) + 2 * n_p) % (2 * n_p);
    return p < n_p ? p : 2 * n_p - 1 - p;
  }
  static bool inside(int h, int d) { return h >= 0 && h < n_h && d >= 0 && d < n_d; }
  static std::size_t index(const Place& c) {
    return static_cast<std::size_t>(fold(c.p)) + std::size_t{n_p} * (static_cast<std::size_t>(c.d) + std::size_t{n_d} * static_cast<std::size_t>(c.h));
  }
  static constexpr std::size_t n_cells = std::size_t{n_h} * n_d * n_p;

  bool known(std::size_t i) const { return variance_[i] >= 0; }
  double log(std::size_t i) const { return log_[i]; }             ///< minus the mean of its theta_h row
  double variance(std::size_t i) const { return variance_[i]; }  ///< of the logarithm
  double row_mean(int h) const { return row_mean_[static_cast<std::size_t>(h)]; }
  std::size_t n_known() const { return n_known_; }

 private:
  std::vector<float> log_, variance_;
  std::array<double, n_h> row_mean_{};
  std::size_t n_known_ = 0;
};

}  // namespace lacquer::brdf
