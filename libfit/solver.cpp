#include "libfit/solver.h"

#include <ceres/cost_function.h>
#include <ceres/iteration_callback.h>
#include <ceres/problem.h>
#include <ceres/solver.h>

#include <algorithm>
#include <cmath>

namespace lacquer::fit {

namespace {

/// Upper Cholesky factor R of a positive semidefinite matrix, R^T R = a, as far as its numerical rank goes: a
/// row whose pivot vanishes beside its diagonal is zero (a parameter the data says nothing about). False: `a`
/// is indefinite, beyond rounding.
bool semidefinite_factor(const std::vector<double>& a, int n, std::vector<double>& factor) {
  constexpr double rounding = 1e-14;
  bool semidefinite = true;
  factor.assign(a.size(), 0.0);
  for (int k = 0; k < n; ++k) {
    double pivot = a[k * n + k];
    for (int i = 0; i < k; ++i) pivot -= factor[i * n + k] * factor[i * n + k];
    semidefinite &= a[k * n + k] >= 0 && pivot >= -1e-10 * a[k * n + k];
    const bool vanishes = !(pivot > rounding * a[k * n + k]);
    const double root = vanishes ? 0 : std::sqrt(pivot);
    factor[k * n + k] = root;
    for (int j = k + 1; j < n; ++j) {
      double sum = a[k * n + j];
      for (int i = 0; i < k; ++i) sum -= factor[i * n + k] * factor[i * n + j];
      if (!vanishes)
        factor[k * n + j] = sum / root;
      else
        semidefinite &=
            std::abs(sum) <= 1e-5 * std::sqrt(std::abs(a[k * n + k])) * std::sqrt(std::abs(a[j * n + j]));
    }
  }
  return semidefinite;
}

/// The whole objective as n + 1 residuals: n rows R with R^T R = the curvature and residuals R^-T g, and one
/// residual without derivative that holds the rest of the cost. Ceres sees the cost and gradient of the
/// millions of single residuals, whose Jacobian is never stored, and a better curvature.
///
/// Parameters at a bound whose gradient points outwards are held (zero column): Ceres would clip their step
/// after solving for it, which spoils the step of everything correlated with them.
class CompressedObjective final : public ceres::CostFunction {
 public:
  CompressedObjective(const Objective& objective, std::vector<double> lower, std::vector<double> upper)
      : objective_(objective), lower_(std::move(lower)), upper_(std::move(upper)) {
    mutable_parameter_block_sizes()->push_back(size());
    set_num_residuals(size() + 1);
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const int n = size();
    const std::vector<double> x(parameters[0], parameters[0] + n);
    std::fill(residuals, residuals + n + 1, 0.0);
    if (!jacobians || !jacobians[0]) {
      // A wild step may overflow. Ceres takes a large cost as a bad step; a failed evaluation it would report
      // on stderr.
      const double cost = objective_.cost(x);
      residuals[n] = std::isfinite(cost) ? std::sqrt(cost) : 1e150;
      return true;
    }
    // The Hessian where it is a bowl over a cost that stays positive, else Gauss-Newton's matrix.
    if (!compress(objective_.quadratic(x, Curvature::newton), x, residuals, jacobians[0]))
      compress(objective_.quadratic(x, Curvature::gauss_newton), x, residuals, jacobians[0]);
    return true;
  }

 private:
  int size() const { return objective_.layout().size(); }

  /// Always fills the output; false where the quadratic has no such form, which for Gauss-Newton's is nothing
  /// but rounding.
  bool compress(Quadratic q, const std::vector<double>& x, double* residuals, double* jacobian) const {
    const int n = size();
    hold_parameters_at_bounds(x, q);
    std::vector<double> factor;
    const bool semidefinite = semidefinite_factor(q.curvature, n, factor);
    double explained = 0;
    for (int k = 0; k < n; ++k) {
      residuals[k] = 0;
      const double diagonal = factor[k * n + k];
      if (diagonal == 0) continue;
      double sum = q.gradient[k];
      for (int i = 0; i < k; ++i) sum -= factor[i * n + k] * residuals[i];
      residuals[k] = sum / diagonal;
      explained += residuals[k] * residuals[k];
    }
    residuals[n] = std::sqrt(std::max(0.0, q.cost - explained));
    std::copy(factor.begin(), factor.end(), jacobian);
    std::fill(jacobian + n * n, jacobian + n * (n + 1), 0.0);
    return semidefinite && explained <= q.cost;
  }

  void hold_parameters_at_bounds(const std::vector<double>& x, Quadratic& q) const {
    const int n = size();
    for (int k = 0; k < n; ++k) {
      if (!((x[k] <= lower_[k] && q.gradient[k] > 0) || (x[k] >= upper_[k] && q.gradient[k] < 0))) continue;
      q.gradient[k] = 0;
      for (int j = 0; j < n; ++j) q.curvature[k * n + j] = q.curvature[j * n + k] = 0;
    }
  }

  const Objective& objective_;
  std::vector<double> lower_, upper_;
};

/// Stops when a step moves nothing that matters: cost is a sum of squares in sigmas, so a gain of 1e-8 moves
/// every parameter by less than about 1e-4 of its standard error. Ends the creeping along valleys of
/// parameters that are not determined.
class StopWhenInsignificant final : public ceres::IterationCallback {
 public:
  ceres::CallbackReturnType operator()(const ceres::IterationSummary& step) override {
    constexpr double insignificant = 1e-8;
    if (step.iteration == 0 || !step.step_is_successful || 2 * step.cost_change > insignificant)
      return ceres::SOLVER_CONTINUE;
    return ceres::SOLVER_TERMINATE_SUCCESSFULLY;
  }
};

std::string reason(const ceres::Solver::Summary& summary) {
  if (summary.termination_type == ceres::USER_SUCCESS) return "Gain of a step is far below the errors";
  // One line, without the numbers of the last step.
  const std::string text = summary.message.substr(0, summary.message.find('\n'));
  return text.substr(0, text.find(". "));
}

}  // namespace

Solution minimise(const Objective& objective, std::vector<double> start, const SolverOptions& options) {
  const ParameterLayout& layout = objective.layout();
  const std::vector<double> lower = layout.lower_bounds(options.min_m), upper = layout.upper_bounds();
  for (std::size_t k = 0; k < start.size(); ++k) start[k] = std::clamp(start[k], lower[k], upper[k]);

  CompressedObjective cost(objective, lower, upper);
  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(problem_options);
  Solution solution{.x = std::move(start)};
  problem.AddResidualBlock(&cost, nullptr, solution.x.data());
  for (int k = 0; k < layout.size(); ++k) {
    problem.SetParameterLowerBound(solution.x.data(), k, lower[k]);
    if (std::isfinite(upper[k])) problem.SetParameterUpperBound(solution.x.data(), k, upper[k]);
  }

  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::DENSE_QR;
  solver.max_num_iterations = options.max_iterations;
  solver.function_tolerance = options.function_tolerance;
  solver.gradient_tolerance = 1e-14;
  solver.parameter_tolerance = 1e-13;
  solver.max_num_consecutive_invalid_steps = 20;
  solver.logging_type = ceres::SILENT;
  solver.num_threads = 1;                                    // the objective is parallel inside
  solver.line_search_interpolation_type = ceres::BISECTION;  // the others evaluate a gradient for each trial
  StopWhenInsignificant stop;
  solver.callbacks.push_back(&stop);
  solver.update_state_every_iteration = false;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);

  solution.cost = 2 * summary.final_cost;
  solution.converged =
      summary.termination_type == ceres::CONVERGENCE || summary.termination_type == ceres::USER_SUCCESS;
  solution.message = reason(summary);
  return solution;
}

}  // namespace lacquer::fit
