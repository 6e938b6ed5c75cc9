#pragma once

#include <optional>
#include <vector>

#include "libcalib/frame_statistics.h"

/// What differs from value to value: sums over frames per value, and maps from them. Internal to libcalib.
namespace lacquer::calib {

/// Straight line over exposure time through the dark frames of each value, all frames with equal weight: base + rate * t. With one
/// exposure time only the rate is 0 and the base is the mean. The weights follow from the times alone, which are known beforehand, so
/// two numbers per value are enough.
class DarkSums {
 public:
  DarkSums(const std::vector<double>& exposures_s, std::size_t n_values);
  void add(const acquire::RawFrame& frame, const FrameShape& shape, const Linearisation& linear);
  /// Temporal noise, from two frames of one exposure time whose mean values differ by `shift` (a - b) per channel.
  void add_pair(const acquire::RawFrame& a, const acquire::RawFrame& b, const FrameShape& shape, const Linearisation& linear,
                const std::vector<double>& shift);

  bool has_rate() const { return spread_ > 0; }
  const std::vector<double>& base() const { return base_; }
  const std::vector<double>& rate() const { return rate_; }
  /// Sum over the pairs of (a - b - shift)^2 / 2.
  const std::vector<float>& pair_sum() const { return pair_sum_; }
  /// Variance of base, of rate and their covariance for temporal variance `constant + per_second * t` of one value and frame.
  struct Errors {
    double base = 0, rate = 0, covariance = 0;
  };
  Errors errors(double constant, double per_second) const;

 private:
  double base_weight(double t) const;
  double rate_weight(double t) const;
  std::vector<double> times_;
  double mean_time_ = 0, spread_ = 0;  ///< spread: sum of (t - mean)^2
  std::vector<double> base_, rate_;
  std::vector<float> pair_sum_;
};

/// Sums of flats above dark, per value.
class FlatSums {
 public:
  explicit FlatSums(std::size_t n_values) : signal_(n_values), changed_(n_values) {}
  /// `use`: per channel, whether this pair counts.
  void add_pair(const acquire::RawFrame& a, const acquire::RawFrame& b, const FrameShape& shape, const Linearisation& linear,
                const DarkSignal& dark, const std::vector<bool>& use);
  const std::vector<double>& signal() const { return signal_; }
  /// The two raw values of every pair are equal.
  bool frozen(std::size_t i) const { return changed_[i] == 0; }

 private:
  std::vector<double> signal_;
  std::vector<std::uint8_t> changed_;
};

/// Median and 1.4826 times the median absolute deviation of the values that are not bad.
struct RobustSpread {
  double median = 0, sigma = 0;
};
RobustSpread robust_spread(const std::vector<double>& values, const BadMask& bad);

/// RMS spread over the values of each channel about the channel's mean, with the share removed that noise of variance `noise` per value
/// puts into it. `lost`: degrees of freedom taken by a model that was divided out. One entry per channel, then that of all channels together.
std::vector<Measured> spread_beyond_noise(const std::vector<double>& values, const FrameShape& shape, const BadMask& bad,
                                          const std::vector<double>& noise, int lost);

/// Sums of flats with their smooth part divided out: per channel a polynomial of degree up to 6 in x and y, fitted to the means of blocks.
struct FlatField {
  std::vector<double> relative;  ///< mean 1 over each channel's values that are not bad, shading removed; 1 where unlit
  std::vector<double> kept;      ///< mean 1 over each channel, shading kept
  std::vector<double> channel_mean;  ///< of the sums
  std::vector<double> shading_range; ///< (max - min) / mean of the smooth part
  BadMask unlit;                 ///< 1: less than 2 % of the mean light, nothing can be said
  int n_terms = 0;               ///< of the polynomial
};
FlatField flat_field(const std::vector<double>& signal, const FrameShape& shape, const BadMask& bad);

/// Upper quantile of chi^2 / dof that one of n values exceeds with probability 0.01 (Wilson and Hilferty 1931).
double largest_by_chance(double degrees_of_freedom, std::size_t n_values);

}  // namespace lacquer::calib
