#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "libbrdf/cook_torrance.h"
#include "libbrdf/table.h"
#include "libfit/usable_cells.h"

namespace lacquer::fit {

/// Cells whose channels [first_channel, first_channel + n_channels) share their directions, as a structure of arrays: what the loops over
/// all cells read. Floats suffice, because a table's coordinates and values are floats; all arithmetic on them is double.
struct CellSet {
  int first_channel = 0, n_channels = 0;
  std::vector<std::uint32_t> cell;    ///< index in the table's grid, ascending
  std::vector<std::uint8_t> usable;   ///< of each cell: bit c: channel c of the table is
  std::vector<float> tan2_theta_h;    ///< tan^2(theta_h)
  std::vector<float> schlick_weight;  ///< (1 - cos(theta_d))^5
  std::vector<float> front;           ///< G / (pi (n.wi)(n.wo) cos^4(theta_h)): what of a lobe depends on the directions alone
  std::vector<float> along, across, mixed;  ///< footprint, see brdf::Footprint; all empty: points
  struct Channel {
    std::vector<float> target;  ///< value that the model is compared with, 1/sr; 1 where not used; minus a lower bound of a clipped cell
    /// 1 / sigma of the logarithm; minus 1 / sigma of the value where values are compared; 0: not used.
    std::vector<float> inverse_sigma;
  };
  std::array<Channel, 3> channels;  ///< [0, n_channels); empty before `weigh`

  std::size_t size() const { return cell.size(); }
};

/// What a fit sees of a table: cells whose channels lie at the same place, then those of each channel that do not.
struct Observations {
  const brdf::HalfAngleTable* table = nullptr;  ///< must outlive the observations; only its means, variances and origins are read again
  int n_channels = 3;
  std::vector<CellSet> sets;
  std::size_t n_cells = 0;   ///< with at least one usable channel
  std::size_t n_values = 0;  ///< usable cells times channels, without bounds
  std::size_t n_bounds = 0;  ///< clipped cells times channels
};

/// Observations of these cells at their mean coordinates, to be weighted by `weigh`. Keeps a reference to the table.
Observations observe(const brdf::HalfAngleTable& table, UsableCells cells);

/// Sets target and sigma of every value. `reference`: model whose values stand in for the noisy means, so that a weight does not depend
/// on the noise of its own cell (which would bias the fit); null: the means themselves.
void weigh(Observations& observations, double model_sigma, const brdf::CookTorrance* reference = nullptr);

}  // namespace lacquer::fit
