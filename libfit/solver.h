#pragma once

#include <string>
#include <vector>

#include "libfit/objective.h"

namespace lacquer::fit {

struct SolverOptions {
  double min_m = 0.001;  ///< lower bound of m
  int max_iterations = 200;
  double function_tolerance = 1e-10;  ///< stop when a step gains less than this share of the cost
};

struct Solution {
  std::vector<double> x;
  double cost = 0;  ///< Quadratic::cost there
  bool converged = false;
  std::string message{};
};

/// Bounded Levenberg-Marquardt (Ceres) from `start`, which is moved into the bounds first.
Solution minimise(const Objective& objective, std::vector<double> start, const SolverOptions& options);

}  // namespace lacquer::fit
