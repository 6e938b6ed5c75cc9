#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "libbrdf/cook_torrance.h"
#include "libfit/observations.h"
#include "libfit/parameters.h"

/// The loops of a fit that touch every cell, vectorised; AVX2 is chosen at run time and gives the same bytes as the baseline.
namespace lacquer::fit {

/// gauss_newton: J^T W J, positive semidefinite, good where residuals are small, and the one that gives the covariance. newton: the
/// Hessian of cost / 2, with the second derivatives of the model. Where a model does not fit the paint (measured films are off by tens
/// of percents) it converges in a few steps where Gauss-Newton creeps; may be indefinite away from a minimum.
enum class Curvature { gauss_newton, newton };

inline constexpr int max_local = 1 + 3 * max_lobes;

/// Sums over the values of one channel. Order of a channel's parameters: kd, ks of each lobe, then ln(m) and r of each lobe.
struct ChannelSums {
  double cost = 0;                                               ///< sum of the robust squares
  std::array<double, max_local> gradient{};                      ///< of cost / 2
  std::array<std::array<double, max_local>, max_local> curvature{};  ///< upper triangle
};
using Sums = std::array<ChannelSums, 3>;

/// Adds the cells [begin, end) of a set to `sums`, by the table's channels. `robust_scale`: Huber threshold, sigmas.
void add_quadratic(const CellSet& set, std::size_t begin, std::size_t end, const brdf::CookTorrance& model, double robust_scale,
                   Curvature kind, Sums& sums);

/// Sum of the robust squares of the cells [begin, end), the same number as add_quadratic's.
double cost(const CellSet& set, std::size_t begin, std::size_t end, const brdf::CookTorrance& model, double robust_scale);

/// Values of the model, 1/sr, at the cells [begin, end) for each channel of the set.
void evaluate(const CellSet& set, std::size_t begin, std::size_t end, const brdf::CookTorrance& model,
              std::array<std::vector<double>, 3>& values);

/// Natural logarithm of each; positive normal numbers only.
void take_logarithms(std::span<double> x);

/// false: the baseline's loops even where AVX2 is there; for tests that compare the two. Not while a fit runs.
void use_vectors(bool yes);

}  // namespace lacquer::fit
