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
/// Its parts: everything but the values, which takes no time; frame i of n (counted from 0) against the first; the values of one frame.
void check_bracket_format(std::span<const acquire::RawFrame> frames);
void check_frame_format(const acquire::RawFrame& frame, const acquire::RawFrame& first, std::size_t i, std::size_t n);
void check_frame_values(const acquire::RawFrame& frame, std::size_t i, std::size_t n);

/// Number of lowest bits that are 0 in all values, i.e. by how much values are left-aligned in their container; 0 where fewer than 32
/// different values are not 0 or the rest would be less than 8 bits.
int left_aligned_bits(std::span<const acquire::RawFrame> frames);
/// Shifts left-aligned values to the right and lowers `bits`; returns by how many bits.
int right_align(std::vector<acquire::RawFrame>& frames);

struct Observation {
  std::uint16_t value;  ///< raw
  std::uint16_t time;   ///< index into BracketSamples::times: which exposure
};

/// Pixels of one channel; pixel i owns observations [first[i], first[i + 1]), ascending in time, at least two different times each.
struct SampledPixels {
  std::vector<Observation> observations;
  std::vector<std::size_t> first{0};
  std::size_t n_pixels() const { return first.size() - 1; }
};

struct BracketSamples {
  int bits = 0;
  /// Seconds, ascending. One entry per frame of all brackets (frames of equal time stay apart: each may be off in its own way); beyond
  /// max_exposures frames one per different time.
  std::vector<double> times;
  /// Index into `times` of each frame, brackets one after another.
  std::vector<std::size_t> exposure_of_frame;
  std::vector<SampledPixels> channels;  ///< 1 or 3

  /// Lowest bits that are 0 in all values: left-aligned where > 0; counted only among enough different values that it is not chance.
  int unused_low_bits = 0;

  /// Every so many-th pixel leaves about `n_pixels` of the fullest channel.
  std::size_t step_to(std::size_t n_pixels) const;
  /// A copy of every step-th pixel.
  BracketSamples thinned(std::size_t step) const;
  /// A copy with times t_j exp(e_j).
  BracketSamples with_times(const std::vector<double>& log_time_corrections) const;
};

constexpr std::size_t max_exposures = 256;

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
