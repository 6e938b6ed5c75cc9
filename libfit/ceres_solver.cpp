#include "libfit/ceres_solver.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>

namespace lacquer::fit {

namespace {

class CompressedCost final : public ceres::CostFunction {
 public:
  explicit CompressedCost(const Objective& objective) : objective_(objective), n_(objective.layout().size()) {
    set_num_residuals(n_ + 1);
    mutable_parameter_block_sizes()->push_back(n_);
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Quadratic q = objective_.quadratic({parameters[0], parameters[0] + n_}, Curvature::gauss_newton);
    if (!std::isfinite(q.cost)) return false;
    const auto n = static_cast<std::size_t>(n_);
    std::vector<double> lower(n * n);  // Cholesky; a pivot that vanishes makes a zero column: nothing depends on that parameter
    double explained = 0;
    for (std::size_t j = 0; j < n; ++j) {
      double pivot = q.curvature[j * n + j];
      for (std::size_t k = 0; k < j; ++k) pivot -= lower[j * n + k] * lower[j * n + k];
      const bool vanishes = !(pivot > 1e-14 * q.curvature[j * n + j]);
      const double root = vanishes ? 0 : std::sqrt(pivot);
      lower[j * n + j] = root;
      for (std::size_t i = j + 1; i < n; ++i) {
        double sum = q.curvature[i * n + j];
        for (std::size_t k = 0; k < j; ++k) sum -= lower[i * n + k] * lower[j * n + k];
        lower[i * n + j] = vanishes ? 0 : sum / root;
      }
      double r = q.gradient[j];
      for (std::size_t k = 0; k < j; ++k) r -= lower[j * n + k] * residuals[k];
      residuals[j] = vanishes ? 0 : r / root;
      explained += residuals[j] * residuals[j];
    }
    residuals[n_] = std::sqrt(std::max(0.0, q.cost - explained));
    if (jacobians && jacobians[0])
      for (std::size_t i = 0; i <= n; ++i)
        for (std::size_t j = 0; j < n; ++j) jacobians[0][i * n + j] = i < n ? lower[j * n + i] : 0;
    return true;
  }

 private:
  const Objective& objective_;
  int n_;
};

}  // namespace

Solution minimise_with_ceres(const Objective& objective, std::vector<double> start, const SolverOptions& options) {
  const Bounds bounds(objective.layout(), options);
  bounds.clamp(start);
  ceres::Problem problem;
  problem.AddResidualBlock(new CompressedCost(objective), nullptr, start.data());
  for (int k = 0; k < objective.layout().size(); ++k) {
    problem.SetParameterLowerBound(start.data(), k, bounds.lower[k]);
    if (std::isfinite(bounds.upper[k])) problem.SetParameterUpperBound(start.data(), k, bounds.upper[k]);
  }
  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::DENSE_QR;
  solver.max_num_iterations = options.max_iterations;
  solver.function_tolerance = 1e-12;
  solver.gradient_tolerance = 1e-14;
  solver.parameter_tolerance = 1e-12;
  solver.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  return {.x = start, .cost = objective.cost(start), .converged = summary.termination_type == ceres::CONVERGENCE,
          .message = "Ceres: " + summary.message.substr(0, 120)};
}

}  // namespace lacquer::fit
