#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "libbrdf/cook_torrance.h"
#include "libbrdf/table.h"
#include "libfit/fit.h"

namespace lacquer::fit {

/// One channel's value of one cell, with how it is compared with the model.
struct Observation {
  double inverse_sigma = 0;  ///< 1 / sigma of the logarithm, or of the value where !logarithmic
  float mean = 0;            ///< 1/sr
  float variance = 0;        ///< of the mean, (1/sr)^2
  float log_bias = 0;  ///< E[ln(true + noise)] = ln(true) - variance / (2 true^2): what is added to ln(mean)
  std::uint8_t channel = 0;
  bool logarithmic = true;
};

/// Directions shared by the observations [first, end).
struct Point {
  brdf::HalfAngleCosines<double> cosines;
  std::uint32_t first = 0, end = 0;
};

/// What a fit sees of a table, in the table's order.
struct Observations {
  int n_channels = 3;
  std::vector<Point> points;
  std::vector<Observation> values;
  std::size_t n_cells = 0;
  std::size_t n_cells_available = 0;
  LeftOut left_out;
};

/// Indices of the cells with at least one usable channel, ascending.
std::vector<std::uint32_t> usable_cells(const brdf::HalfAngleTable& table, const FitOptions& options,
                                        LeftOut& left_out);

/// At most `max_cells` of `cells` (ascending indices), spread over theta_h, theta_d and phi_d: every
/// (theta_h, theta_d) group gives the same number of cells, or all it has. Full where the grid is sparse, as
/// at the peak of a clear coat. Deterministic.
std::vector<std::uint32_t> stratified_choice(const std::vector<std::uint32_t>& cells, std::size_t max_cells);

/// Observations of these cells at their mean coordinates, weighted by `weigh` without a reference.
Observations observe(const brdf::HalfAngleTable& table, const std::vector<std::uint32_t>& cells,
                     const FitOptions& options);

/// Sets sigma and kind of every observation. `reference`: model whose values stand in for the noisy means, so
/// that a weight does not depend on the noise of its own cell (which would bias the fit); null: the means
/// themselves.
void weigh(Observations& observations, double model_sigma, const brdf::CookTorrance* reference = nullptr);

}  // namespace lacquer::fit
