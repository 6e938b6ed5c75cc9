#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "libbrdf/table.h"
#include "libfit/fit.h"

namespace lacquer::fit {

/// Decision about every cell of a table.
struct UsableCells {
  std::vector<std::uint32_t> cells;    ///< with at least one usable channel, ascending
  std::vector<std::uint8_t> channels;  ///< of each of `cells`: bit c: channel c is usable; `apart`: they lie at different places
  bool footprints = false;             ///< one of them has one
  LeftOut left_out;

  static constexpr std::uint8_t apart = 8;
};
UsableCells usable_cells(const brdf::HalfAngleTable& table, const FitOptions& options);

/// At most `max_cells` of the cells, spread over theta_h, theta_d and phi_d: every (theta_h, theta_d) group gives the same number of
/// cells, or all it has. Full where the grid is sparse, as at the peak of a clear coat. Deterministic.
UsableCells stratified_choice(const UsableCells& cells, std::size_t max_cells);

}  // namespace lacquer::fit
