#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "libbrdf/cook_torrance.h"
#include "libbrdf/table.h"
#include "libfit/fit.h"

namespace lacquer::fit {

/// Cells whose channels [first_channel, first_channel + n_channels) share their directions, as a structure of arrays: what the loops over
/// all cells read. Floats suffice, because a table's coordinates and values are floats; all arithmetic on them is double.
struct CellSet {
  int first_channel = 0, n_channels = 0;
  std::vector<std::uint32_t> cell;    ///< index in the table's grid, ascending
  std::vector<float> tan2_theta_h;    ///< tan^2(theta_h)
  std::vector<float> schlick_weight;  ///< (1 - cos(theta_d))^5
  std::vector<float> front;           ///< G / (pi (n.wi)(n.wo) cos^4(theta_h)): what of a lobe depends on the directions alone
  std::vector<float> along, across, mixed;  ///< footprint, see brdf::Footprint; all empty: points
  struct Channel {
    std::vector<float> target;  ///< value that the model is compared with, 1/sr; 1 where not used; minus a lower bound of a clipped cell
    /// 1 / sigma of the logarithm; minus 1 / sigma of the value where values are compared; 0: not used.
    std::vector<float> inverse_sigma;
  };
  std::array<Channel, 3> channels;  ///< [0, n_channels)

  std::size_t size() const { return cell.size(); }
};

/// What a fit sees of a table: cells whose channels lie at the same place, then those of each channel that do not.
struct Observations {
  const brdf::HalfAngleTable* table = nullptr;  ///< must outlive the observations
  int n_channels = 3;
  std::vector<CellSet> sets;
  std::size_t n_cells = 0;   ///< with at least one usable channel
  std::size_t n_values = 0;  ///< usable cells times channels, without bounds
  std::size_t n_bounds = 0;  ///< clipped cells times channels
};

/// Decision about every cell of a table.
struct UsableCells {
  std::vector<std::uint32_t> cells;    ///< with at least one usable channel, ascending
  std::vector<std::uint8_t> channels;  ///< of each of `cells`: bit c: channel c is usable
  LeftOut left_out;
};
UsableCells usable_cells(const brdf::HalfAngleTable& table, const FitOptions& options);

/// At most `max_cells` of the cells, spread over theta_h, theta_d and phi_d: every (theta_h, theta_d) group gives the same number of
/// cells, or all it has. Full where the grid is sparse, as at the peak of a clear coat. Deterministic.
UsableCells stratified_choice(const UsableCells& cells, std::size_t max_cells);

/// Observations of these cells at their mean coordinates, to be weighted by `weigh`. Keeps a reference to the table.
Observations observe(const brdf::HalfAngleTable& table, const UsableCells& cells);

/// Sets target and sigma of every value. `reference`: model whose values stand in for the noisy means, so that a weight does not depend
/// on the noise of its own cell (which would bias the fit); null: the means themselves.
void weigh(Observations& observations, double model_sigma, const brdf::CookTorrance* reference = nullptr);

/// Relative error that the cells of one (theta_h, theta_d) share, because the model cannot follow the paint there: what the scatter of the
/// groups' mean residuals has beyond their sigma. Robust (median); 0 where the model fits, up to four times the variance expected.
/// Wants observations weighed with `model` as reference.
double shared_error(const Observations& observations, const brdf::CookTorrance& model);

/// Takes such an error into the weights: however many cells a group has, it says no more than 1 / shared^2. Otherwise the many cells of a
/// paint's base outvote those of its peak wherever the model fits neither.
void limit_groups(Observations& observations, double shared);

}  // namespace lacquer::fit
