#pragma once

#include <span>
#include <vector>

#include "libcalib/photon_transfer.h"

/// The photon-transfer line. Internal to libcalib.
namespace lacquer::calib {

/// variance = constant + slope * mean + square * light_square, DN^2.
struct TransferLine {
  double constant = 0, slope = 0, square = 0;
  double constant_variance = 0, slope_variance = 0, square_variance = 0, covariance = 0;  ///< covariance: of constant and slope
  double chi_square = 0;
  int degrees_of_freedom = 0;
  bool has_slope = false;   ///< the points' means differ enough to see a slope
  bool has_square = false;

  double at(const TransferPoint& p) const { return constant + slope * p.mean + square * p.light_square; }
};

/// Variance of `point`'s variance where `line` holds: chi-square for normal noise, the fourth cumulant of Poisson noise (its variance
/// is slope * mean), and the spread of the signal over the frame.
double variance_of_variance(const TransferLine& line, const TransferPoint& point);

/// Iteratively reweighted least squares over the points whose use is `fitted`; weights are from the line, not from the measured
/// variances, which would favour those that came out low. The square term is kept where it is positive and significant (3 sigma).
/// Standard errors are widened by sqrt(chi^2 / dof) where chi^2 says that the line does not hold (beyond 3.5 sigma of chi^2).
TransferLine fit_transfer_line(std::span<const TransferPoint> points);

/// Sets `use` of the points of ONE channel, whose flats' clipped share is known already: from the first level (by mean) where the
/// variance falls 5 standard errors and 3 % below the line of the levels below, all are `variance_drop`, and so are those whose noise
/// reaches that level; where enough others remain, points of noise too small against rounding are `quantised`.
void choose_points(std::vector<TransferPoint>& points);

}  // namespace lacquer::calib
