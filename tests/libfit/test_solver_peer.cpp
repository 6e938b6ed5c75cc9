#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include "fit_test_support.h"
#include "libfit/solver.h"

/// Ceres as an independent solver of the same objective.
namespace lacquer::test {
namespace {

class Cost final : public ceres::FirstOrderFunction {
 public:
  explicit Cost(const fit::Objective& objective) : objective_(objective) {}
  int NumParameters() const override { return objective_.layout().size(); }
  bool Evaluate(const double* x, double* cost, double* gradient) const override {
    const fit::Quadratic q = objective_.quadratic({x, x + NumParameters()});
    *cost = q.cost / 2;
    if (gradient) std::copy(q.gradient.begin(), q.gradient.end(), gradient);
    return std::isfinite(*cost);
  }

 private:
  const fit::Objective& objective_;
};

/// Where Ceres' quasi-Newton method ends, and Quadratic::cost there.
double ceres_minimum(const fit::Objective& objective, std::vector<double>& x) {
  const ceres::GradientProblem problem(new Cost(objective));
  ceres::GradientProblemSolver::Options options;
  options.line_search_direction_type = ceres::BFGS;
  options.max_num_iterations = 2000;
  options.function_tolerance = 1e-13;
  options.logging_type = ceres::SILENT;
  ceres::GradientProblemSolver::Summary summary;
  ceres::Solve(options, problem, x.data(), &summary);
  return 2 * summary.final_cost;
}

TEST(SolverPeer, CeresFindsNoLowerMinimum) {
  const brdf::CookTorrance truth = paint("opel-titan");
  const brdf::HalfAngleTable table = with_noise(table_of(truth, 101), 0.05, 0, 11);
  fit::Observations observations = fit::observe(table, fit::usable_cells(table, {}));
  fit::weigh(observations, 0.01, &truth);
  const fit::Objective objective(observations, fit::ParameterLayout(3, {.n_lobes = 3}), {});
  // All of it 10 % off, within the bounds, which Ceres' method does not know.
  std::vector<double> start = objective.layout().pack(truth);
  for (double& x : start) x *= 0.9;
  const fit::Solution ours = fit::minimise(objective, start, {});
  ASSERT_TRUE(ours.converged) << ours.message;
  std::vector<double> theirs = start, from_ours = ours.x;
  const double their_cost = ceres_minimum(objective, theirs);
  EXPECT_LT(their_cost, objective.cost(start) / 2) << "Ceres must have gone somewhere";
  EXPECT_LE(ours.cost, their_cost * (1 + 1e-9));
  // A sum of squares in sigmas: a thousandth moves no parameter by more than 0.03 of its error.
  EXPECT_NEAR(ceres_minimum(objective, from_ours), ours.cost, 1e-3);
}

}  // namespace
}  // namespace lacquer::test
