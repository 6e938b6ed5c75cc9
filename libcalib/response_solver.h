#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "libcalib/bracket_samples.h"
#include "libcalib/noise_model.h"
#include "libcalib/response.h"
#include "libcalib/response_algebra.h"
#include "libcalib/response_channel.h"

namespace lacquer::calib {

/// Response curves of all channels and corrections e_j of the listed exposure times (t_j exp(e_j), common to the channels) as one
/// least-squares problem, see ResponseChannel. Internal to response.cpp and exposure_times.cpp.
class ResponseSolver {
 public:
  /// `samples` must outlive the solver.
  ResponseSolver(int bits, double black_level, int saturation, const BracketSamples& samples);

  void start_from_power_law();
  void start_from_line();
  void set_curves(const Response& response);

  struct Round {
    const NoiseModel* noise = nullptr;  ///< null: not known yet, 1/256 of the range RMS everywhere
    double slope_change = 0.1;          ///< as in ResponseOptions
    double time_sigma = 0;              ///< typical |e_j|; 0: times are exact. Far larger e_j are not pulled back: a false time is false.
    std::size_t pixel_step = 1;         ///< every so many-th pixel
  };
  /// One Gauss-Newton round for curves and times. Returns the RMS change of ln f, each level as its data weigh.
  double refine(const Round& round);
  /// The same with the curves held. Returns the largest change of an e_j.
  double refine_times(const Round& round);

  /// Normal equations of [coefficients of channel 0, 1, ..., e_j] without priors, at the present solution.
  struct Equations {
    SymmetricMatrix a, scatter;
    std::vector<double> b;
  };
  Equations equations(const Round& round, bool scatter);
  std::size_t first_time() const { return first_time_; }  ///< index of e_0 in them
  std::size_t first_coefficient(std::size_t channel) const { return channel * channels_[0].coefficients().size(); }
  double time_precision(std::size_t j, double time_sigma) const;  ///< of the prior of e_j

  /// Curves with their band, from the covariance that the scatter of the pixels gives, plus the priors. `sampled_step`: the covariance is
  /// that of round.pixel_step, seen through every sampled_step-th pixel.
  Response response_with_band(const Round& round, std::size_t sampled_step);
  /// Fits the e_j anew with the curves held and next to no prior, so that none is kept at 0 by it. Returns their sigma for these pixels,
  /// infinite where they say nothing.
  std::vector<double> loosen_times(Round round);

  Response response() const;  ///< without band
  void reset_times();  ///< e_j = 0
  /// Whether some e_j is more than chance and 0.05 %.
  bool times_differ(const std::vector<double>& log_time_sigma) const;
  const std::vector<double>& log_time_corrections() const { return corrections_; }
  /// Robust standard deviation of the e_j about their median and exponent, in [1e-4, 0.1]; of frames that the pixels say something about.
  double spread_of_times() const;
  const std::vector<ResponseChannel>& channels() const { return channels_; }
  double residual_rms() const { return residual_rms_; }  ///< of log exposure, weighted, in the last round

 private:
  bool is_seen(std::size_t j) const;  ///< whether the pixels know e_j to 3 %
  std::vector<double> time_sigma(const SymmetricMatrix& covariance) const;
  double exponent_of_times() const;
  void take_exponent_to_curves();
  std::vector<std::size_t> band_values(const ResponseChannel& channel) const;
  void add_curve_prior(std::size_t channel, double slope_change, SymmetricMatrix& a, std::vector<double>& b) const;
  void add_time_prior(double time_sigma, SymmetricMatrix& a, std::vector<double>& b) const;

  int bits_;
  std::vector<ResponseChannel> channels_;
  std::size_t first_time_ = 0;
  std::vector<double> log_times_;
  std::vector<double> corrections_;
  double exponent_ = 0;                   ///< of the e_j over ln t_j, where the curves are held
  std::vector<double> time_information_;  ///< of each e_j, in the last round
  double residual_rms_ = 0;
};

/// Pixels per channel that noise is seen with.
constexpr std::size_t noise_pixels = 10000;
/// Spread of the times' errors that is assumed before the pixels have shown it.
constexpr double loose_time_sigma = 0.05;

struct TimeFit {
  int iterations = 0;
  bool converged = false;
  std::vector<double> log_sigma;  ///< of the e_j
};

/// Errors of the times for curves that are known; black level and saturation are taken from `known`, the noise from the samples.
TimeFit fit_times(ResponseSolver& solver, const BracketSamples& samples, const Response& response, const NoiseModel& known);

/// Corrections of frames, brackets one after another. Gauge: the median of each bracket's seen frames is 0; frames that are not seen (sigma
/// infinite) stay as listed.
struct FrameTimes {
  std::vector<double> log_correction, log_sigma;
};
FrameTimes times_of_frames(std::span<const std::size_t> bracket_sizes, const BracketSamples& samples, const std::vector<double>& corrections,
                           const std::vector<double>& log_sigma);

}  // namespace lacquer::calib
