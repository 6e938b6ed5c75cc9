#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "libacquire/frame.h"

/// Checks of a bracket and the subset of its pixels that response and noise are estimated from.
namespace lacquer::calib {

/// All frames alike in size, layout, bits and gain, data complete and within [0, 2^bits), exposures in [1e-9, 1e6] s.
/// Throws Error{input} naming the first frame that is not (counted from 1).
void check_bracket(std::span<const acquire::RawFrame> frames);

struct Observation {
  std::uint16_t value;  ///< raw
  std::uint16_t time;   ///< index into BracketSamples::times
};

/// Pixels of one channel; pixel i owns observations [first[i], first[i + 1]), ascending in time, at least two different times each.
struct SampledPixels {
  std::vector<Observation> observations;
  std::vector<std::size_t> first{0};
  std::size_t n_pixels() const { return first.size() - 1; }
};

struct BracketSamples {
  std::vector<double> times;            ///< seconds, ascending, no duplicates
  std::vector<SampledPixels> channels;  ///< 1 or 3
};

struct SamplingOptions {
  int max_pixels = 50000;    ///< per channel
  int ignore_border_px = 0;
  int lowest_value = 1;      ///< raw values below say nothing
  int saturation_value = 0;  ///< raw values from here on say nothing
};

/// Pixels spread over the image and, as evenly as the scene allows, over brightness (highlights are few but hold the upper levels).
/// Deterministic. Throws Error{input} where brackets differ in bits or layout, or no two exposures differ.
BracketSamples sample_brackets(std::span<const std::vector<acquire::RawFrame>> brackets, const SamplingOptions& options);

}  // namespace lacquer::calib
