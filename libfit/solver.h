#pragma once

#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "libfit/objective.h"

namespace lacquer::fit {

struct SolverOptions {
  double min_m = 0.001;  ///< lower bound of m
  int max_iterations = 200;
  double function_tolerance = 1e-10;  ///< stop when the next step promises less than this share of the cost
  /// Stop when the next step promises less than this, whatever the cost is: a sum of squares in sigmas that falls by 1e-6 moves every
  /// parameter by less than about 1e-3 of its standard error.
  double insignificant = 1e-6;
  double damping = 1e-4;  ///< of the first step; 0 where the start is known to be near
  std::optional<std::pair<int, double>> fixed = std::nullopt;  ///< this parameter is held at this value
  bool ceres = false;  ///< by Ceres' solver, see ceres_solver.h
};

/// Bounds of the solver's parameters.
struct Bounds {
  std::vector<double> lower, upper;
  Bounds(const ParameterLayout& layout, const SolverOptions& options);
  void clamp(std::vector<double>& x) const;
};

struct Solution {
  std::vector<double> x;
  double cost = 0;  ///< Quadratic::cost there
  bool converged = false;
  std::string message{};
};

/// Bounded Levenberg-Marquardt from `start`, which is moved into the bounds first. The curvature is the Hessian where that is a bowl,
/// else Gauss-Newton's. Evaluates the objective once per trial and never for a step that is not worth it: near a minimum of millions of
/// cells two or three passes are all, where a general solver takes a dozen.
Solution minimise(const Objective& objective, std::vector<double> start, const SolverOptions& options);

/// The same for any objective that gives a quadratic at `x`, by our own solver.
using QuadraticAt = std::function<Quadratic(const std::vector<double>& x, Curvature kind)>;
Solution minimise(const QuadraticAt& objective, const ParameterLayout& layout, std::vector<double> start, const SolverOptions& options);

}  // namespace lacquer::fit
