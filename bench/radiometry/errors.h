#pragma once

#include <array>
#include <functional>
#include <span>
#include <vector>

#include "bench/radiometry/reference.h"
#include "bench/radiometry/stack.h"
#include "libcalib/radiance_image.h"

namespace lacquer::bench {

/// |x / truth - 1| over the valid values, after each channel is divided by its median x / truth there: an unknown response leaves one
/// factor per channel open.
struct RadianceError {
  double median = 0, percentile95 = 0;
  std::array<double, 3> scale{1, 1, 1};  ///< median x / truth per channel
  std::size_t n = 0;
  std::size_t not_finite = 0;            ///< values of the valid ones that are NaN or infinite; their error counts as infinite
  std::size_t n_clipped = 0;             ///< values whose true exposure clips even the shortest frame
  double clipped_below_bound = 0;        ///< fraction of them below half of the radiance that they are at least, or not finite
};

/// 1 where the reference knows the value to 10 % or better: not clipped in all exposures, not lost in noise.
std::vector<std::uint8_t> valid_values(const Stack& stack, const ReferenceImage& reference);

RadianceError radiance_error(std::span<const float> radiance, const Stack& stack, std::span<const std::uint8_t> valid);

/// (x / scale - truth) / sigma of the values whose signal in the longest exposure lies in one decade.
struct LevelStatistics {
  double log10_signal;  ///< lower end of the decade: true light in the longest exposure as a fraction of full scale
  std::size_t n;
  double mean, standard_deviation;
};

/// Decades with at least `min_n` values; values flagged clipped or invalid are left out, dark ones are not.
std::vector<LevelStatistics> standardised_errors(const calib::RadianceImage& image, const std::array<double, 3>& scale,
                                                 const Stack& stack, std::size_t min_n);

struct ResponseError {
  double rms = 0;      ///< of ln(curve / truth), all channels
  double largest = 0;  ///< |ln|
  int lowest = 0, highest = 0, levels = 0;  ///< raw values compared, of one channel at least
};

/// `exposure(channel, v)`, any scale: it is brought into the gauge (right at value 2^(bits-1)). Compared at the levels that hold at least
/// `min_count` values of the stack, from the one where a value's signal is three times its noise to below the highest.
ResponseError response_error(const std::function<double(int, int)>& exposure, const Stack& stack, std::size_t min_count);

double quantile(std::vector<double> values, double q);

}  // namespace lacquer::bench
