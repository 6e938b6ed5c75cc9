#pragma once

#include <vector>

#include "libfit/fit.h"
#include "libfit/objective.h"

namespace lacquer::fit {

/// Fills parameters, covariance and reduced_chi2 of `result` at `x`, the solution, from the quadratics there.
///
/// Covariance: inverse of the Gauss-Newton matrix, each parameter's sigma raised where the residuals show that it is too small: by
/// reduced chi^2 > 1 (scatter larger than the stated errors), or by residuals that agree with each other within a theta_h row or a
/// theta_d column or a view (errors of model, discretisation, single lights), which the cluster-robust sandwich of Liang and Zeger 1986 measures.
/// Raised only where the excess is more than chance: a parameter that few rows determine has a sandwich that scatters by itself, as
/// chi^2 with Satterthwaite's degrees of freedom. Not determined, with sigma 0: a parameter that takes part in a direction along which
/// the objective does not change, m known worse than its own size, r known worse than its range. ks, m, r of a lobe that is off (all its
/// ks at 0) are left out; other parameters at a bound keep the sigma of the curvature, so that a physical limit does not make what is
/// correlated with them look certain.
void add_uncertainty(const ParameterLayout& layout, const std::vector<double>& x, const GroupedQuadratics& quadratics,
                     std::size_t n_values, double min_m, FitResult& result);

/// kd and ks are proportional to the scale, m and r do not depend on it: its relative error is one more, common term of their covariance.
void add_scale_error(double scale_sigma, FitResult& result);

/// Half vectors that are off by `sigma` radians (RMS) point elsewhere in every view, so that they blur a lobe rather than move it: m^2 + sigma^2
/// in place of m^2. What m may be off by then joins its error.
void add_half_vector_error(double sigma, FitResult& result);

/// Adds to the covariance what errors of the calibration make of the parameters. `moved`: quadratics at the same solution of the data as it
/// would be with each independent error one standard error large; the parameters would follow by a Gauss-Newton step.
void add_calibration_error(const ParameterLayout& layout, const Quadratic& here, const std::vector<Quadratic>& moved, FitResult& result);

/// False: a lobe's strength is within 10 standard errors of none, in every channel and both at normal incidence, ks r, and at theta_d of 80
/// degrees. What a criterion takes for a weak lobe may be errors that neighbouring cells share, beside a narrow lobe above all: these are
/// in the standard errors. From the parameters and covariance of `result`.
bool every_lobe_shows(const FitResult& result);

/// Factor >= 1 by which the objective's differences overstate what the data says: reduced chi^2, or the mean over the parameters of the
/// sandwich's variance beside the Gauss-Newton matrix's, whichever is largest.
double overdispersion(const ParameterLayout& layout, const std::vector<double>& x, const GroupedQuadratics& q, std::size_t n_values);

/// Eigenvalues (ascending) and eigenvectors (row k belongs to value k) of a symmetric row-major matrix, by
/// Jacobi's rotations.
struct Eigensystem {
  std::vector<double> values, vectors;
};
Eigensystem symmetric_eigensystem(std::vector<double> a, int n);

}  // namespace lacquer::fit
