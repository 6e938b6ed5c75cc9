#include "libfit/profile.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace lacquer::fit {

namespace {

/// One side of one parameter's profile.
class Side {
 public:
  Side(const Objective& objective, const std::vector<double>& x, double cost, const SolverOptions& solver, int k, double bound)
      : objective_(objective), x_(x), cost_(cost), solver_(solver), k_(k), bound_(bound) {}

  /// Where the rise is `target`^2 * `inflation`^2; `step`: first guess of the distance, with its sign.
  double end(double step, double target, double inflation) const {
    const double direction = step > 0 ? 1 : -1, farthest = std::abs(bound_ - x_[k_]);
    std::vector<double> from = x_;
    // The root of the rise is nearly proportional to the distance: false position on it, within a bracket.
    double low = 0, rise_low = 0, high = farthest, distance = std::min(std::abs(step), farthest);
    bool bracketed = false;
    double rise_high = 0;
    for (int i = 0; i < 12; ++i) {
      const double rise = root_of_rise(direction * distance, from) / inflation;
      if (std::abs(rise - target) <= 0.01 * target) return x_[k_] + direction * distance;
      if (rise < target) {
        if (distance >= farthest) return bound_;
        low = distance, rise_low = rise;
      } else {
        high = distance, rise_high = rise, bracketed = true;
      }
      if (bracketed)
        distance = low + (high - low) * std::clamp((target - rise_low) / (rise_high - rise_low), 0.05, 0.95);
      else
        distance = std::min(farthest, distance * std::clamp(rise > 0 ? target / rise * 1.02 : 4.0, 1.1, 4.0));
    }
    return x_[k_] + direction * distance;
  }

 private:
  double root_of_rise(double offset, std::vector<double>& from) const {
    SolverOptions options = solver_;
    options.fixed = {k_, offset >= 0 ? std::min(x_[k_] + offset, std::max(bound_, x_[k_])) : std::max(x_[k_] + offset, std::min(bound_, x_[k_]))};
    options.insignificant = 1e-3;
    const Solution solution = minimise(objective_, from, options);
    from = solution.x;
    return std::sqrt(std::max(0.0, solution.cost - cost_));
  }

  const Objective& objective_;
  const std::vector<double>& x_;
  double cost_;
  SolverOptions solver_;
  int k_;
  double bound_;
};

/// `sigma`: of the solver's parameter, ln(m) for m.
bool misleads(double x, double sigma, double lower, double upper, bool is_log) {
  return x - 2 * sigma < lower || x + 2 * sigma > upper || (is_log && 2 * sigma > 0.5);
}

}  // namespace

void add_profiles(const Objective& objective, const std::vector<double>& x, const SolverOptions& solver, Profiled which, FitResult& result) {
  const std::vector<double> lower = objective.layout().lower_bounds(solver.min_m), upper = objective.layout().upper_bounds();
  std::vector<bool> is_log(x.size(), false);
  for (int l = 0; l < objective.layout().n_lobes(); ++l) is_log[objective.layout().log_m(l)] = true;
  const auto sigma_of = [&](int k) { return is_log[k] ? result.parameters[k].sigma / result.parameters[k].value : result.parameters[k].sigma; };
  std::vector<int> wanted;
  for (int k = 0; k < objective.layout().size(); ++k)
    if (result.parameters[k].determined && result.parameters[k].sigma > 0 &&
        (which == Profiled::all || misleads(x[k], sigma_of(k), lower[k], upper[k], is_log[k])))
      wanted.push_back(k);
  if (wanted.empty()) return;
  const double cost = objective.cost(x);
  tbb::parallel_for(std::size_t{0}, wanted.size(), [&](std::size_t i) {
    const int k = wanted[i];
    Parameter& p = result.parameters[k];
    const double sigma = sigma_of(k);
    const auto value = [&](double at) { return is_log[k] ? std::exp(at) : at; };
    const Side below(objective, x, cost, solver, k, lower[k]), above(objective, x, cost, solver, k, upper[k]);
    p.profile = ProfileInterval{.low68 = value(below.end(-sigma, 1, p.inflation)),
                                .high68 = value(above.end(sigma, 1, p.inflation)),
                                .low95 = value(below.end(-2 * sigma, 1.959964, p.inflation)),
                                .high95 = value(above.end(2 * sigma, 1.959964, p.inflation))};
  });
}

}  // namespace lacquer::fit
