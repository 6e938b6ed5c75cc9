#pragma once

#include <span>
#include <vector>

namespace lacquer::fit {

struct NonnegativeSolution {
  std::vector<double> x;
  double reduction = 0;  ///< 2 b.x - x.G.x: what x takes off the squared residual of x = 0
};

/// argmin over x >= 0 of x.G.x - 2 b.x (Lawson and Hanson 1974, ch. 23, on normal equations). G: row-major n
/// x n, symmetric, positive semidefinite. Made for few unknowns; columns may be linearly dependent.
NonnegativeSolution nonnegative_least_squares(std::span<const double> gram, std::span<const double> b);

}  // namespace lacquer::fit
