#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "libcalib/merge_weights.h"

/// The loops of a merge that touch every raw value. Compiled for AVX2 too and chosen at run time; neither uses fused multiply-add, so
/// that every machine gives the same bytes.
namespace lacquer::calib {

/// Sums and usable exposures of consecutive values.
struct SumsView {
  std::array<float*, n_sums> sums;
  std::uint32_t* usable;  ///< bit j % 32: exposure j is not clipped
};

/// Raw values of one exposure that belong to the same pixels as a SumsView.
struct ExposureValues {
  const std::uint16_t* values;
  float basis1, basis2;  ///< b_1 and b_2 of the time; b_0 is 1
  std::uint32_t bit;
  bool shortest;  ///< the shortest exposure of the view
};

/// How raw values become exposures. What is said of value i of a stretch holds for every value i + period, i + 2 period, ... of it.
struct ValueMeaning {
  bool linear;
  float black;            ///< linear: exposure = value - black
  std::uint32_t largest;  ///< 2^bits - 1
  std::size_t period;     ///< 1, 2 or 3
  /// [shortest exposure][i % period]: values from here on are clipped.
  std::array<std::array<std::int32_t, 3>, 2> clipped;
  // Curved: with p = value >> node_shift, rest = value - (p << node_shift), exposure = table[p] if node_shift is 0, else
  // table[2 p] + rest * table[2 p + 1]: all values of a curve of 16 bits would not fit into the second-level cache.
  int node_shift;
  std::array<const float*, 3> tables;  ///< of value i % period
};

/// Adds n values of each exposure to the sums. Returns false where a raw value is beyond `largest`; the sums are then spoilt.
bool add_exposures(const ExposureValues* exposures, std::size_t n_exposures, std::size_t n, const ValueMeaning& meaning, SumsView out);

/// Sums of consecutive values; `usable_high`: exposures from 32 on, null where there are none.
struct ConstSums {
  std::array<const float*, n_sums> sums;
  const std::uint32_t* usable;
  const std::uint32_t* usable_high;
};

/// How sums become radiances where no value has maps of its own and the usable exposures are the first ones.
struct FinishTables {
  MergeWeightTable weights;
  const float* inverse_prediction_time;  ///< [count - 1]
  float dark_rate;
  std::size_t period;
  std::array<std::int32_t, 3> channels;  ///< of value i % period
};

/// Radiance, variance and flag (0 valid, 2 dark) of n < 65536 values. Returns how many were left out, and which: those whose usable
/// exposures are not the first ones, none, or followed by one whose clipping is in doubt. `left_out`: room for n.
std::size_t finish_values(const ConstSums& sums, std::size_t n, const FinishTables& tables, float* radiance, float* variance,
                          std::uint8_t* flags, std::uint16_t* left_out);

}  // namespace lacquer::calib
