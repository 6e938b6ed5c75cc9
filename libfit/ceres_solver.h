#pragma once

#include "libfit/solver.h"

namespace lacquer::fit {

/// As minimise, by Ceres' trust-region solver with bounds. Ceres sees the least-squares problem compressed to as many residuals as there are
/// parameters, J = L^T and r = L^-1 g of the normal equations L L^T = J^T W J, and one more that makes the cost right.
Solution minimise_with_ceres(const Objective& objective, std::vector<double> start, const SolverOptions& options);

}  // namespace lacquer::fit
