#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "libcalib/bracket_samples.h"
#include "libcalib/noise_model.h"
#include "libcalib/response_algebra.h"

namespace lacquer::calib {

/// ln f(v) = ln mid + gamma (s - s_mid) + spline(c), s = ln(v - black): a power law, of which the line v - black is one, times a cubic
/// spline. Knots are uniform in c(s) = 2 A (sqrt((v - black) / range) - ..) + B s: every 2.6 % at the top, as dense as shot noise lets
/// levels be told apart below, and six per factor e in the dark. Internal to the response solver.
class ResponseSpline {
 public:
  struct Basis {
    std::size_t first = 0;           ///< coefficients first .. first + 3
    std::array<double, 4> weight{};  ///< their weights, sum 1
  };
  ResponseSpline(int bits, double black_level);

  std::size_t n_coefficients() const { return static_cast<std::size_t>(n_intervals_) + 3; }
  double coordinate(double s) const;
  double log_signal(double c) const;  ///< s at coordinate c
  Basis basis(double c) const;        ///< clamped to the ends
  /// Weights of the coefficients in d^2 spline / d s^2.
  Basis second_derivative(double c) const;
  double lowest() const { return s_low_; }
  double highest() const { return s_high_; }

 private:
  int n_intervals_ = 0;
  double s_low_ = 0, s_high_ = 0, per_root_ = 0, per_log_ = 0;
};

/// One channel: its curve, its pixels, and what the pixels say about curve and exposure times. Internal to the response solver.
///
/// Robertson et al. 2003 minimise sum_ij w_ij (f(v_ij) - t_j x_i)^2 over the curve f and the radiances x_i, alternating between the
/// two, which takes hundreds of rounds. Here the radiances are eliminated pixel by pixel and the curve comes out of one dense solve
/// per round, of which a handful is enough. Differences to the paper, all for the sake of the true likelihood:
/// - Weights are inverse variances (noise model) of the PREDICTED exposure z_ij = t_j x_i.
/// - A residual corrects the curve at the predicted value f^-1(z_ij), not at the measured one. Residuals of a weighted mean are
///   uncorrelated with the mean, so this is unbiased; grouping by the noisy value is not (it shifts the curve by 1 / SNR^2).
/// - A rounded value stands for the mean of f over its level, f + f'' / 24, not for f at its middle.
/// - The listed times may be wrong: t_j exp(e_j) takes the place of t_j.
class ResponseChannel {
 public:
  ResponseChannel(int bits, double black_level, int saturation, const SampledPixels& pixels, const std::vector<double>& times);

  /// Normal equations of the changes of [coefficients, e_j], radiances eliminated.
  struct Equations {
    SymmetricMatrix a;
    std::vector<double> b;
    SymmetricMatrix scatter;  ///< sum over the pixels of gradient gradient^T: covariance of b that trusts no noise model; if asked for
    double squares = 0, weights = 0;  ///< of relative residuals
  };

  void start_from_power_law();
  void start_from_line();              ///< f = v - black
  void set_curve(const std::vector<double>& exposure);  ///< any curve, one exposure per value; the spline then has no part in it
  /// Adds a change to the coefficients and restores the gauge; the curve is then made strictly increasing.
  void change_spline(const double* change);

  /// ln f divided by `factor`, about mid-range.
  void divide_exponent(double factor);

  /// What the pixels i, i + step, i + 2 step ... say. `noise` null: not known yet, 1/256 of the range RMS everywhere.
  Equations equations(const NoiseModel* noise, const std::vector<double>& log_time_corrections, std::size_t pixel_step, bool scatter) const;

  const ResponseSpline& spline() const { return spline_; }
  const std::vector<double>& coefficients() const { return coefficients_; }
  double gamma() const { return gamma_; }
  const std::vector<double>& exposure() const { return exposure_; }  ///< every value, strictly increasing, in the gauge of ResponseCurve
  ResponseSpline::Basis basis_of_value(std::size_t v) const { return spline_.basis(place_of_value_[v]); }
  std::size_t first_value() const { return first_; }  ///< the lowest above black
  double mid_log_signal() const { return mid_; }
  std::size_t n_pixels() const { return pixels_.n_pixels(); }

 private:
  struct Row;
  struct Lookup;
  struct Accumulator;
  void update_exposure();
  Lookup make_lookup(const NoiseModel* noise) const;
  void collect_rows(std::size_t pixel, const Lookup& lookup, const std::vector<double>& times, std::vector<Row>& rows) const;

  int bits_;
  double black_, mid_;
  int saturation_;
  std::size_t first_;
  const SampledPixels& pixels_;
  const std::vector<double>& times_;
  ResponseSpline spline_;
  double gamma_ = 1;
  std::vector<double> coefficients_;
  std::vector<double> place_of_value_;  ///< c of each value above black
  std::vector<double> log_signal_;      ///< s of each value above black
  std::vector<double> exposure_;        ///< of each value
};

}  // namespace lacquer::calib
