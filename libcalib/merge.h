#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "libacquire/frame.h"
#include "libcalib/noise_model.h"
#include "libcalib/radiance_image.h"
#include "libcalib/response.h"
#include "libcalib/sensor_maps.h"

namespace lacquer::calib {

/// Merges the exposures of one view after another into radiance with variance. Frames are taken in as they come and are not kept: the
/// memory is 16 to 20 bytes per value, however many exposures there are (merge_weights.h says how).
/// - Each exposure is weighted by the inverse of the variance predicted for it (from all exposures together, not from its own noisy
///   value, which would bias dark pixels low).
/// - Clipped values never enter as values; one near the threshold enters as the lower bound that it is (censored likelihood, which
///   removes the bias of leaving out just the frames whose noise was positive). Levels on the shoulder of a curve that tell less than
///   a quarter of what the best level tells count as clipped too, but in the shortest exposure.
/// - Clipped in all frames: flag `clipped`, radiance = largest lower bound, variance = that of a value at the threshold of that frame.
/// - Signal to noise of the merged value < 1: flag `dark`, value (possibly negative) and variance kept.
/// - Sensor maps: offset, dark signal and flat field of each value are taken out, bad values get the flag `invalid`.
/// Radiance unit: linearised DN per second.
class BracketMerger {
 public:
  /// `planned_times`: exposure times of a view, 1 to 64, seconds, any order; the frames' own times are used, these only say how many
  /// there are and which is the shortest. Throws Error{input} where response, noise or maps are out of range.
  BracketMerger(const Response& response, const NoiseModel& noise, std::vector<double> planned_times, SensorMaps maps = {});
  ~BracketMerger();

  /// Takes the next frame of the view. Throws Error{input} naming the frame whose size, layout, bits, gain or exposure is wrong.
  /// Frames in ascending order of time are merged fastest; the order changes no more than the last bits.
  void add(const acquire::RawFrame& frame);
  std::size_t n_frames() const;

  /// The merged view; at least one frame. The next frame begins another view (of the same size and layout).
  RadianceImage finish();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// Merges a bracket that is in memory, tile by tile. Any order of the frames gives the same bytes, and so does any number of threads.
/// Throws Error{input} as BracketMerger.
RadianceImage merge_bracket(std::span<const acquire::RawFrame> frames, const Response& response, const NoiseModel& noise,
                            const SensorMaps& maps = {});
/// The same into an image whose memory is used again.
void merge_bracket(std::span<const acquire::RawFrame> frames, const Response& response, const NoiseModel& noise, const SensorMaps& maps,
                   RadianceImage& image);

}  // namespace lacquer::calib
