#pragma once

#include <cstddef>
#include <vector>

#include "libcalib/bracket_samples.h"

namespace lacquer::calib {

/// One channel's response as a least-squares problem, internal to response.cpp.
///
/// Robertson et al. 2003 minimise sum_ij w_ij (f(v_ij) - t_j x_i)^2 over the curve f and the radiances x_i, alternating between the two,
/// which takes hundreds of rounds. Divided by its expected value each residual is, to first order, that of the logarithm,
///   g(v_ij) - log t_j - log x_i,   g = log f,   weight = f^2 / variance(f),
/// which is linear in both g and log x_i: the radiances are eliminated pixel by pixel and the curve comes out of ONE dense solve.
/// g(v) = log(v - black) + h(v), h linear between knots in log(v - black): a linear sensor (h = 0) and a power law are exact.
/// A weak penalty on the second derivative of h in log(v - black) fills levels that no pixel has and settles the ambiguity described
/// at ResponseOptions::slope_change.
class ResponseSolver {
 public:
  ResponseSolver(int bits, double black_level, const SampledPixels& pixels, const std::vector<double>& times, double slope_change);

  struct Step {
    std::vector<double> exposure;  ///< every value, strictly increasing, in the gauge of ResponseCurve
    double residual_rms;           ///< weighted, of log exposure
  };
  /// `weights`: inverse variance of log exposure per value, 0 = says nothing. `robust`: values that contradict the others of their
  /// pixel, as judged with the curve of the call before, count less (Cauchy weights).
  Step solve(const std::vector<double>& weights, bool robust);

 private:
  struct Normal;
  struct Interpolation {
    int knot;      ///< and knot + 1
    double upper;  ///< weight of knot + 1, [0, 1]
  };
  void add_pixel(std::size_t pixel, const std::vector<double>& weights, bool robust, Normal& normal) const;
  void add_smoothness(Normal& normal) const;
  double residual_rms(const std::vector<double>& weights) const;
  std::vector<double> curve() const;
  double log_exposure(int value) const;

  int bits_;
  double black_;
  const SampledPixels& pixels_;
  const std::vector<double>& times_;
  double slope_change_;
  std::vector<double> knots_;                  ///< log(v - black)
  std::vector<Interpolation> interpolation_;   ///< per value; values at or below black are never asked for
  std::vector<double> h_;                      ///< per knot
};

}  // namespace lacquer::calib
