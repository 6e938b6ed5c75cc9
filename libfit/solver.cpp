#include "libfit/solver.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "libfit/ceres_solver.h"

namespace lacquer::fit {

namespace {

/// Solves a z = b by Cholesky for the indices `free` of an n x n matrix with unit diagonal plus `damping`; a pivot that vanishes (a
/// parameter the data says nothing about) makes a zero. False: `a` is indefinite, beyond rounding.
bool solve(const std::vector<double>& a, const std::vector<double>& b, const std::vector<int>& free, int n, double damping,
           std::vector<double>& z) {
  constexpr double rounding = 1e-14;
  const int size = static_cast<int>(free.size());
  std::vector<double> lower(static_cast<std::size_t>(size) * size), y(free.size());
  std::vector<bool> vanishes(free.size());
  for (int i = 0; i < size; ++i) {
    for (int j = 0; j <= i; ++j) {
      double sum = a[free[i] * n + free[j]] + (i == j ? damping : 0);
      for (int k = 0; k < j; ++k) sum -= lower[i * size + k] * lower[j * size + k];
      if (i == j) {
        if (sum < -1e-10) return false;
        vanishes[i] = sum <= rounding;
        lower[i * size + i] = vanishes[i] ? 0 : std::sqrt(sum);
      } else if (vanishes[j]) {
        if (std::abs(sum) > 1e-5) return false;
        lower[i * size + j] = 0;
      } else {
        lower[i * size + j] = sum / lower[j * size + j];
      }
    }
    double sum = b[free[i]];
    for (int k = 0; k < i; ++k) sum -= lower[i * size + k] * y[k];
    y[i] = vanishes[i] ? 0 : sum / lower[i * size + i];
  }
  z.assign(b.size(), 0.0);
  for (int i = size - 1; i >= 0; --i) {
    double sum = y[i];
    for (int k = i + 1; k < size; ++k) sum -= lower[k * size + i] * z[free[k]];
    z[free[i]] = vanishes[i] ? 0 : sum / lower[i * size + i];
  }
  return true;
}

struct Step {
  std::vector<double> to;  ///< within the bounds
  double gain = 0;         ///< of the cost, as the quadratic promises it
};

/// The quadratic's minimum within a box.
class BoundedStep {
 public:
  BoundedStep(const Quadratic& q, const std::vector<double>& x, const std::vector<double>& lower, const std::vector<double>& upper)
      : n_(static_cast<int>(x.size())), x_(x), lower_(lower), upper_(upper), scale_(x.size()), g_(q.gradient), h_(q.curvature) {
    for (int i = 0; i < n_; ++i) {
      const double diagonal = std::abs(h_[i * n_ + i]);
      scale_[i] = diagonal > 0 ? 1 / std::sqrt(diagonal) : 0;
    }
    for (int i = 0; i < n_; ++i) {
      g_[i] *= scale_[i];
      for (int j = 0; j < n_; ++j) h_[i * n_ + j] *= scale_[i] * scale_[j];
    }
  }

  /// False: the curvature is no bowl, even damped.
  bool step(double damping, Step& out) const {
    // Parameters at a bound that the gradient pushes outwards stay there; those that the step carries to a bound are put on it, one after
    // the other, and the rest is solved again: clipping the whole step would spoil everything correlated with them.
    std::vector<double> p(x_.size()), fixed(x_.size());
    std::vector<bool> held(x_.size());
    for (int i = 0; i < n_; ++i)
      held[i] = scale_[i] == 0 || (x_[i] <= lower_[i] && g_[i] > 0) || (x_[i] >= upper_[i] && g_[i] < 0);
    for (;;) {
      std::vector<int> free;
      std::vector<double> rhs(x_.size());
      for (int i = 0; i < n_; ++i) {
        if (held[i]) continue;
        free.push_back(i);
        rhs[i] = -g_[i];
        for (int j = 0; j < n_; ++j) rhs[i] -= h_[i * n_ + j] * fixed[j];
      }
      if (!solve(h_, rhs, free, n_, damping, p)) return false;
      int worst = -1;
      double excess = 0;
      for (const int i : free) {
        const double to = x_[i] + scale_[i] * p[i];
        const double beyond = std::max(lower_[i] - to, to - upper_[i]) / scale_[i];
        if (beyond > excess) worst = i, excess = beyond;
      }
      if (worst < 0) break;
      held[worst] = true;
      fixed[worst] = ((p[worst] < 0 ? lower_ : upper_)[worst] - x_[worst]) / scale_[worst];
    }
    out.to = x_;
    out.gain = 0;
    for (int i = 0; i < n_; ++i) {
      if (held[i]) p[i] = fixed[i];
      out.to[i] = std::clamp(x_[i] + scale_[i] * p[i], lower_[i], upper_[i]);
    }
    for (int i = 0; i < n_; ++i) {
      double hp = 0;
      for (int j = 0; j < n_; ++j) hp += h_[i * n_ + j] * p[j];
      out.gain -= p[i] * (2 * g_[i] + hp);
    }
    return true;
  }

 private:
  int n_;
  std::vector<double> x_, lower_, upper_, scale_, g_, h_;  // gradient and curvature scaled to a unit diagonal
};

}  // namespace

Bounds::Bounds(const ParameterLayout& layout, const SolverOptions& options)
    : lower(layout.lower_bounds(options.min_m)), upper(layout.upper_bounds()) {
  if (options.fixed) lower[options.fixed->first] = upper[options.fixed->first] = options.fixed->second;
}

void Bounds::clamp(std::vector<double>& x) const {
  for (std::size_t k = 0; k < x.size(); ++k) x[k] = std::clamp(x[k], lower[k], upper[k]);
}

Solution minimise(const Objective& objective, std::vector<double> start, const SolverOptions& options) {
  if (options.ceres) return minimise_with_ceres(objective, std::move(start), options);
  return minimise([&](const std::vector<double>& x, Curvature kind) { return objective.quadratic(x, kind); }, objective.layout(), std::move(start), options);
}

Solution minimise(const QuadraticAt& objective, const ParameterLayout& layout, std::vector<double> start, const SolverOptions& options) {
  const Bounds bounds(layout, options);
  const std::vector<double>&lower = bounds.lower, &upper = bounds.upper;
  bounds.clamp(start);
  Solution solution{.x = std::move(start)};
  Quadratic q = objective(solution.x, Curvature::newton);
  bool gauss_newton = false;
  double damping = options.damping, growth = 4;
  const auto finish = [&](bool converged, const char* message) {
    solution.cost = q.cost;
    solution.converged = converged;
    solution.message = message;
    return solution;
  };
  // A model that does not fit the paint may have a bent valley (ks r constant, r near 0) in which every step is short: after this many
  // trials that together gained next to nothing, going on is not worth it.
  constexpr int patience = 10;
  constexpr double creeping = 1e-5;
  double cost_before = q.cost;
  for (int iteration = 0; iteration < options.max_iterations; ++iteration) {
    if (iteration > 0 && iteration % patience == 0) {
      if (cost_before - q.cost < creeping * q.cost) return finish(true, "The last steps gained next to nothing");
      cost_before = q.cost;
    }
    Step step;
    if (!BoundedStep(q, solution.x, lower, upper).step(damping, step) || step.gain < 0) {
      // The Hessian is no bowl here; Gauss-Newton's matrix always is but for rounding.
      if (gauss_newton) {
        damping = std::max(1e-8, damping * growth);
        growth *= 2;
        if (damping > 1e16) return finish(false, "No step lowers the cost");
      } else {
        q = objective(solution.x, Curvature::gauss_newton);
        gauss_newton = true;
      }
      continue;
    }
    const bool small_damping = damping <= 1e-3;
    if (small_damping && step.gain <= std::max(options.insignificant, options.function_tolerance * q.cost)) {
      solution.x = step.to;  // too small to be worth a look
      q.cost = std::max(0.0, q.cost - step.gain);
      return finish(true, "The next step gains far less than the errors");
    }
    Quadratic next = objective(step.to, Curvature::newton);
    const double ratio = (q.cost - next.cost) / step.gain;
    if (std::isfinite(next.cost) && ratio > 1e-3) {
      solution.x = std::move(step.to);
      q = std::move(next);
      gauss_newton = false;
      damping *= std::clamp(1 - std::pow(2 * ratio - 1, 3), 0.1, 2.0);  // Nielsen 1999
      if (damping < 1e-12) damping = 0;
      growth = 4;
      continue;
    }
    if (step.gain <= 1e-13 * q.cost) return finish(true, "The next step is below rounding");
    damping = std::max(1e-6, damping) * growth;
    growth *= 2;
    if (damping > 1e16) return finish(false, "No step lowers the cost");
  }
  return finish(false, "Maximum number of iterations reached");
}

}  // namespace lacquer::fit
