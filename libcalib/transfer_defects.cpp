#include <algorithm>
#include <cmath>

#include "libcalib/transfer_measurement.h"

/// Dead and erratic values, and the noise of the flat field.
namespace lacquer::calib {

namespace {

constexpr double dead_below = 0.5, dead_above = 1.5;  ///< of the channel's mean sensitivity

/// Logarithm of the probability that two values of temporal variance `variance` (rounding included) come out equal.
double log_equal(double variance) {
  return std::min(0.0, -std::log(2 * std::sqrt(3.14159265358979323846 * variance)));
}

struct PairNoise {
  double expected = 0;   ///< sum over the pairs of the temporal variance
  double square = 0;     ///< of its square: effective number of pairs = expected^2 / square
  double log_equal = 0;
  void add(double variance) {
    expected += variance;
    square += variance * variance;
    log_equal += calib::log_equal(variance);
  }
  double degrees_of_freedom() const { return square > 0 ? expected * expected / square : 0; }
};

}  // namespace

std::vector<double> TransferMeasurement::noise_of_flat() const {
  std::vector<double> noise;
  for (std::size_t c = 0; c < n_channels(); ++c) {
    double variance = 0, frames = 0, seconds = 0;
    for (const PairRecord& p : flat_pairs_) {
      if (!p.good(c)) continue;
      variance += 2 * std::max(p.statistics[c].variance, p.statistics[c].quantisation);
      frames += 2;
      seconds += 2 * p.exposure_s;
    }
    if (has_darks()) {
      const DarkSums::Errors e = dark_errors(c);
      if (dark_.base_map) variance += frames * frames * e.base;
      if (dark_.rate_map) variance += seconds * seconds * e.rate;
      if (dark_.base_map && dark_.rate_map) variance += 2 * frames * seconds * e.covariance;
    }
    const double mean = flat_ ? flat_->channel_mean[c] : 0;
    noise.push_back(mean > 0 ? variance / (mean * mean) : 0);
  }
  return noise;
}

void TransferMeasurement::find_dead() {
  if (!flat_) return;
  const ChannelMap channel_of(shape());
  const double certain = std::log(0.01 / static_cast<double>(shape().n_values()));  // less than one of 100 sensors by chance
  std::vector<PairNoise> noise(n_channels());
  for (const PairRecord& p : flat_pairs_)
    for (std::size_t c = 0; c < n_channels(); ++c)
      if (p.good(c)) noise[c].add(std::max(p.statistics[c].variance, p.statistics[c].quantisation));
  n_dead_ = 0;
  for (std::size_t i = 0; i < bad_.size(); ++i) {
    const std::size_t c = channel_of(i);
    if (bad_[i] || flat_->unlit[i]) continue;
    const bool insensitive = flat_->relative[i] < dead_below || flat_->relative[i] > dead_above;
    const bool frozen = flat_sums_->frozen(i) && noise[c].log_equal < certain;
    if (!insensitive && !frozen) continue;
    bad_[i] = 1;
    ++n_dead_;
  }
}

void TransferMeasurement::find_erratic() {
  if (!has_darks()) return;
  const ChannelMap channel_of(shape());
  std::vector<PairNoise> noise(n_channels());
  double seconds = 0;
  for (const PairRecord& p : dark_pairs_) {
    // Half a DN^2 at least: below, a single step of one DN would be an outlier.
    for (std::size_t c = 0; c < n_channels(); ++c) noise[c].add(std::max(p.statistics[c].variance, 6 * p.statistics[c].quantisation));
    seconds += p.exposure_s;
  }
  const TransferLine& line = lines_.back();
  n_erratic_ = 0;
  for (std::size_t i = 0; i < bad_.size(); ++i) {
    if (bad_[i]) continue;
    const std::size_t c = channel_of(i);
    // The shot noise of a dark current above the mean is no fault.
    const double more_dark = dark_sums_->has_rate() ? std::max(dark_sums_->rate()[i] - dark_lines_[c].rate->value, 0.0) : 0;
    const double expected = noise[c].expected + std::max(line.slope, 0.0) * more_dark * seconds;
    const double limit = std::max(options_.erratic_ratio * options_.erratic_ratio,
                                  largest_by_chance(noise[c].degrees_of_freedom(), shape().n_values()));
    if (!(static_cast<double>(dark_sums_->pair_sum()[i]) > limit * expected)) continue;
    bad_[i] = 1;
    ++n_erratic_;
  }
}

}  // namespace lacquer::calib
