#pragma once

#include <cstdint>
#include <vector>

#include "libfit/kernels.h"
#include "libfit/observations.h"
#include "libfit/parameters.h"

namespace lacquer::fit {

struct ObjectiveOptions {
  double robust_scale = 3.0;   ///< Huber threshold, sigmas
  double energy_weight = 0.0;  ///< see FitOptions; 0 where the table's scale is relative
};

/// Twice the objective with gradient and curvature of the objective, all exact sums over the observations.
struct Quadratic {
  double cost = 0;                ///< sum of the robust squares; the solver's objective is half of it
  std::vector<double> gradient;   ///< J^T W r: derivative of cost / 2
  std::vector<double> curvature;  ///< by kind, row-major n x n, symmetric
};

/// Adds the sums of a channel of `n` parameters to another's.
void add(const ChannelSums& from, int n, ChannelSums& to);

/// The channels' sums as a quadratic of the solver's parameters, with the energy penalty of `n_values` values; without one: weight 0.
Quadratic quadratic_of(const ParameterLayout& layout, const Sums& sums, const brdf::CookTorrance& model, double energy_weight, std::size_t n_values);

/// Robust sum of squared residuals of the model over the observations, with analytic derivatives. Parameters as in ParameterLayout.
///
/// Residual: ln((f + t) / (target + t)) / sigma with t = 1e-3 target, which is the logarithm of the ratio unless the model is off by a
/// factor of hundreds and stays finite where it underflows; (f - target) / sigma for weak signals. Only normal equations are kept, never a
/// Jacobian, so memory does not grow with the number of cells. The sums run over fixed chunks: the result has the same bits for any
/// number of threads.
class Objective {
 public:
  /// Keeps a reference: `observations` must outlive the objective and keep their weights.
  Objective(const Observations& observations, ParameterLayout layout, ObjectiveOptions options);

  const ParameterLayout& layout() const { return layout_; }
  const Observations& observations() const { return *observations_; }
  const ObjectiveOptions& options() const { return options_; }

  double cost(const std::vector<double>& x) const;
  Quadratic quadratic(const std::vector<double>& x, Curvature kind = Curvature::gauss_newton) const;

 private:
  const Observations* observations_;
  ParameterLayout layout_;
  ObjectiveOptions options_;
};

/// Gauss-Newton quadratics: all cells, and groups of cells that may share an error. Groups without cells are left out and do not contain
/// the energy penalty.
struct GroupedQuadratics {
  Quadratic all;
  std::vector<Quadratic> theta_h_rows, theta_d_columns;
  std::vector<Quadratic> views;  ///< of a fit to samples; else empty
};
GroupedQuadratics grouped_quadratics(const Objective& objective, const std::vector<double>& x);

/// Estimate of the albedo at normal incidence per channel: kd + sum of 4 ks r (1 - exp(-0.6 / m^2)). The
/// lobe's integral over the hemisphere at normal incidence has no closed form because of shadowing; the last
/// factor is within 2 % of it for all m in (0, 1].
glm::dvec3 normal_incidence_albedo(const brdf::CookTorrance& model);

}  // namespace lacquer::fit
