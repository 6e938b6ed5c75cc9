#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <limits>
#include <vector>

#include "libcalib/noise_model.h"
#include "libcalib/response.h"

/// Weights of a merge, internal to merge.cpp.
///
/// The best weights of a bracket are w_j(x) = t_j / var_j(x t_j). They depend on the radiance x, which is known only at the end. But as
/// functions of the time they are smooth, so three sums per value carry (almost) all that the frames say:
///   S_k = sum_j b_k(t_j) e_j,   b = {1, sqrt(t), t},   e_j the linearised value of a usable exposure.
/// At the end x = sum_k a_k S_k, where a minimises the variance among all a with sum_k a_k sum_j b_k(t_j) t_j = 1 (unbiased) - the best linear
/// unbiased estimator within the span of b. Its standard deviation exceeds that of the ideal weights by at most 0.7 % for sensors with
/// read, shot and up to 1 % of relative noise and brackets up to six decades (docs/radiometry.md has the table). a depends only on which
/// exposures were usable and on x, on the latter slowly: tables of four steps per octave hold it. So frames may come one at a time and need
/// not be kept.
namespace lacquer::calib {

/// Powers of the time in seconds; sums over 64 frames of values up to 1e9 and times of 1e-9 to 1e6 s stay within float.
inline constexpr int n_sums = 3;
std::array<double, n_sums> time_basis(double exposure_s);

/// How a value comes out of the sums, and its variance; 32 bytes.
struct MergeWeight {
  std::array<float, n_sums> a;  ///< x = sum a_k S_k - dark_rate - offset_gain * offset
  float offset_gain;            ///< sum_k a_k sum_j b_k(t_j), 1/s
  float variance0, variance1;   ///< var(x) = variance0 + variance1 * x for x within the bin
  float variance_dark;          ///< and this times the dark rate of the value beyond the nominal one, DN/s
  /// Radiance above which the exposure after the usable ones is clipped beyond doubt; -inf after the last.
  float certain = -std::numeric_limits<float>::infinity();
};

/// Weights by channel, number of usable exposures and radiance: entries[((channel * n_exposures) + count - 1) * n_bins + bin_of(x)].
struct MergeWeightTable {
  /// Four bins per octave, by the leading bits of a float.
  static constexpr int bin_shift = 21;

  const MergeWeight* entries;
  std::int32_t n_exposures, first_bin, n_bins;

  std::int32_t bin_of(float x) const {
    const std::int32_t bin = (std::bit_cast<std::int32_t>(x) >> bin_shift) - first_bin + 1;  // negative x: negative bits, first bin
    return bin < 0 ? 0 : (bin < n_bins ? bin : n_bins - 1);
  }
  float lower_edge(std::int32_t bin) const { return bin == 0 ? 0.0f : std::bit_cast<float>((first_bin + bin - 1) << bin_shift); }
  const MergeWeight& at(std::int32_t channel, std::int32_t count, std::int32_t bin) const {
    return entries[(channel * n_exposures + count - 1) * n_bins + bin];
  }
  /// Variance at x, where w are the weights of the bin: within it, it is linear in x.
  float variance(const MergeWeight& w, std::int32_t bin, float x) const {
    const float low = lower_edge(bin), high = lower_edge(bin + 1);
    return w.variance0 + w.variance1 * (x < low ? low : (x < high ? x : high));
  }
};

/// Slope^2 / 12 of a curve as a function of exposure: quantisation noise of a PREDICTED exposure. Taking it at the measured value
/// instead would tie the weight to that value's noise. 32 steps per octave.
class QuantisationNoise {
 public:
  /// `exposure`: strictly increasing exposures of the raw values.
  explicit QuantisationNoise(const std::vector<double>& exposure);
  double operator()(double z) const;

 private:
  std::vector<float> variance_;
};

/// Time and what does not depend on radiance of one exposure.
struct ExposureNoise {
  double time;      ///< seconds
  double constant;  ///< read noise, dark shot noise and, where the response is linear, quantisation; DN^2
};

class MergeWeights {
 public:
  /// `exposures` in any order. `curves`: per channel; empty: linear, all channels alike. `largest`: radiance above which nothing is usable.
  MergeWeights(const std::vector<ExposureNoise>& exposures, const std::vector<QuantisationNoise>& curves, const NoiseModel& noise,
               double largest);

  /// Where the exposures of the first `count` indices are usable (count >= 1).
  MergeWeightTable table() const { return {entries_.data(), bins_.n_exposures, bins_.first_bin, bins_.n_bins}; }
  /// Where the first `count` exposures are usable.
  void set_certain(std::size_t channel, std::int32_t count, float radiance);
  /// For any set, computed anew, for a radiance near x; bit j: exposure j.
  MergeWeight of_set(std::size_t channel, std::uint64_t usable, float x) const;
  /// sum b_last t over a set: the prediction is S_last / this.
  double prediction_time(std::uint64_t usable) const;
  /// Variance of the linearised value of exposure j at exposure z >= 0, DN^2.
  double exposure_variance(std::size_t channel, std::size_t j, double z) const;
  std::size_t n_channels() const { return curves_.empty() ? 1 : curves_.size(); }

 private:
  struct Moments;
  double middle(std::int32_t bin) const;
  void add(Moments& m, std::size_t channel, std::size_t j, double x) const;
  MergeWeight solve(const Moments& m, std::size_t channel, std::uint64_t usable, std::int32_t bin) const;

  std::vector<ExposureNoise> exposures_;
  std::vector<std::array<double, n_sums>> basis_;
  std::vector<QuantisationNoise> curves_;
  double shot_, relative2_;
  MergeWeightTable bins_{};  ///< its entries stay null: they may move with this
  std::vector<MergeWeight> entries_;
};

}  // namespace lacquer::calib
