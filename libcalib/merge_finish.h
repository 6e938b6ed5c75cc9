#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "libcalib/merge_kernels.h"
#include "libcalib/merge_weights.h"
#include "libcalib/noise_model.h"
#include "libcalib/radiance_image.h"
#include "libcalib/response.h"
#include "libcalib/sensor_maps.h"

/// From sums to radiance, variance and flag. Internal to merge.cpp.
namespace lacquer::calib {

/// Raw value -> linearised value, as the merge needs it.
class SensorTables {
 public:
  /// `shortest_s`: the shortest exposure time; that exposure uses every level below saturation.
  SensorTables(const Response& response, const NoiseModel& noise, double shortest_s);

  bool linear() const { return linear_; }
  /// For the kernels; `channels` of the values i, i + period, ...
  ValueMeaning meaning(const std::array<std::size_t, 3>& channels, std::size_t period) const;
  /// Of read-back times, which differ a little from the plan.
  bool is_shortest(double exposure_s) const { return exposure_s <= 1.001 * shortest_s_; }
  /// Exposure at which rounding starts to give a clipped value.
  double threshold(std::size_t channel, double exposure_s) const {
    return is_shortest(exposure_s) ? channels_[channel].shortest_threshold : channels_[channel].threshold;
  }
  const std::vector<QuantisationNoise>& quantisation() const { return quantisation_; }  ///< per channel; linear: empty
  std::size_t n_channels() const { return channels_.size(); }

 private:
  struct Channel {
    double threshold, shortest_threshold;
    std::int32_t clipped, shortest_clipped;  ///< raw values from here on
  };
  bool linear_;
  float black_;
  int bits_, node_shift_;
  std::vector<float> table_;  ///< channel by channel, as ValueMeaning
  double shortest_s_;
  std::vector<Channel> channels_;
  std::vector<QuantisationNoise> quantisation_;
};

class MergeFinish {
 public:
  /// Refers to its arguments.
  MergeFinish(const SensorTables& tables, const NoiseModel& noise, const std::vector<double>& times, const SensorMaps& maps);
  /// Value i of the sums (n < 65536) becomes value first + i of the image; its channel is channels[i % period].
  void store(const ConstSums& sums, std::size_t first, std::size_t n, const std::array<std::size_t, 3>& channels, std::size_t period,
             RadianceImage& image) const;

 private:
  /// What one value has of its own beside the sums.
  struct Pixel {
    double offset, dark_rate;
  };
  struct Estimate {
    double value, variance;
    PixelFlag flag;
  };
  double threshold(std::size_t channel, std::size_t j) const { return threshold_[channel * times_.size() + j]; }
  Estimate estimate(std::size_t channel, std::uint64_t usable, const std::array<float, n_sums>& s, const Pixel& pixel) const;
  void add_lower_bounds(std::size_t channel, std::uint64_t usable, const Pixel& pixel, Estimate& e) const;
  Estimate lower_bound(std::size_t channel, const Pixel& pixel) const;
  void correct(std::size_t index, Estimate& e) const;
  void store_one(const ConstSums& sums, std::size_t i, std::size_t first, std::size_t channel, RadianceImage& image) const;
  float certain_radiance(std::size_t channel, std::size_t j) const;

  const std::vector<double>& times_;
  const SensorMaps& maps_;
  double dark_rate_;                  ///< of values without a map, linearised DN per second
  std::vector<std::size_t> by_time_;  ///< indices of the exposures, ascending in time
  bool ascending_;                    ///< that is their order
  std::vector<double> threshold_;     ///< [channel * n_exposures + j]: exposure from which values are clipped
  std::optional<MergeWeights> weights_;
  std::vector<float> inverse_prediction_time_;  ///< as FinishTables
};

}  // namespace lacquer::calib
