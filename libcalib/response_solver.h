#pragma once

#include <cstddef>
#include <vector>

#include "libcalib/bracket_samples.h"
#include "libcalib/noise_model.h"

namespace lacquer::calib {

/// One channel's response as a least-squares problem, internal to response.cpp.
///
/// Robertson et al. 2003 minimise sum_ij w_ij (f(v_ij) - t_j x_i)^2 over the curve f and the radiances x_i, alternating between the
/// two, which takes hundreds of rounds. Here the radiances are eliminated pixel by pixel and the curve comes out of one dense solve
/// per round, of which a handful is enough. Two things differ from the paper, both for the sake of the true likelihood:
/// - Weights are inverse variances (noise model) of the PREDICTED exposure z_ij = t_j x_i.
/// - A residual corrects the curve at the predicted value f^-1(z_ij), not at the measured one. Residuals of a weighted mean are
///   uncorrelated with the mean, so this is unbiased; grouping by the noisy value is not (it shifts the curve by 1 / SNR^2).
///
/// f(v) = (v - black) * exp(h(v)), h linear between knots in log(v - black): a linear sensor (h = 0) and a power law are exact.
/// A penalty on the second derivative of h in log(v - black) fills levels that no pixel has, settles the ambiguity described at
/// ResponseOptions::slope_change, and keeps the curve from structure finer than the noise, which data cannot show.
class ResponseSolver {
 public:
  ResponseSolver(int bits, double black_level, int saturation, const SampledPixels& pixels, const std::vector<double>& times);

  /// Best power law: the start.
  void fit_power_law();
  /// One round. `noise` null: not known yet, 1/256 of the range RMS everywhere. `slope_change`: as in ResponseOptions.
  /// Returns the RMS change of log f, each level as its data weigh.
  double refine(const NoiseModel* noise, double slope_change);

  std::vector<double> curve() const;  ///< every value, strictly increasing, in the gauge of ResponseCurve
  double residual_rms() const { return residual_rms_; }  ///< of log exposure, weighted, in the last round

 private:
  struct Normal;
  struct Row;
  struct Place {
    std::size_t knot;  ///< and knot + 1
    double upper;      ///< weight of knot + 1; [0, 1] within the knots
    double slope;      ///< d f / d v
  };
  Place place_of_log_value(double s) const;
  Place place_of_log_exposure(double g) const;
  void collect_rows(std::size_t pixel, const NoiseModel* noise, const std::vector<double>& exposure, std::vector<Row>& rows) const;
  void add_rows(const std::vector<Row>& rows, Normal& normal) const;
  double variance_at(double z, double slope, const NoiseModel* noise) const;  ///< of exposure, DN^2
  void add_prior(const NoiseModel* noise, double slope_change, Normal& normal) const;
  double update(Normal& normal);

  int bits_;
  double black_;
  int saturation_;
  const SampledPixels& pixels_;
  const std::vector<double>& times_;
  std::vector<double> log_times_;
  std::vector<double> knots_;         ///< s = log(v - black)
  std::vector<double> log_exposure_;  ///< g = s + h at the knots, strictly increasing
  double residual_rms_ = 0;
};

}  // namespace lacquer::calib
