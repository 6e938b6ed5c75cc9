#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "libcalib/merge_weights.h"

/// The loops of a merge that touch every raw value. Compiled for AVX2 too and chosen at run time; neither uses fused multiply-add, so
/// that every machine gives the same bytes.
namespace lacquer::calib {

/// A lookup table holds this for raw values that are clipped; exposures are below 1e30.
inline constexpr float clipped_marker = 2e30f, clipped_limit = 1e30f;

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
  const float* table;    ///< curved response: exposures of all raw values of channel 0, then those of channel 1, ...; else not used
};

/// How raw values become exposures. Value i of a stretch has the table offset offsets[i % 3 or % 2 or % 1 = i % period].
struct ValueMeaning {
  bool linear;
  float black;                        ///< linear: exposure = value - black
  std::int32_t clipped;               ///< linear: values from here on are clipped
  std::uint32_t largest;              ///< 2^bits - 1
  std::size_t period;
  std::array<std::int32_t, 3> offsets;  ///< into ExposureValues::table, of the channel of value i % period
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
  /// [channel * n_exposures + count - 1]: radiance above which the next exposure is clipped beyond doubt; -inf for the last.
  const float* certain;
  float dark_rate;
  std::size_t period;
  std::array<std::int32_t, 3> channels;  ///< of value i % period
};

/// Radiance, variance and flag (0 valid, 2 dark) of n < 65536 values. Returns how many were left out, and which: those whose usable
/// exposures are not the first ones, none, or followed by one whose clipping is in doubt. `left_out`: room for n.
std::size_t finish_values(const ConstSums& sums, std::size_t n, const FinishTables& tables, float* radiance, float* variance,
                          std::uint8_t* flags, std::uint16_t* left_out);

}  // namespace lacquer::calib
