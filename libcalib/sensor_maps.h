#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "libacquire/frame.h"

namespace lacquer::calib {

/// What differs from value to value of a sensor (EMVA 1288, DSNU and PRNU) and which values cannot be trusted. In the mosaic's own
/// geometry: each vector is empty or has width * height * values_per_pixel(layout) entries, row-major, rgb interleaved.
/// With linearised DN z of a raw value (exposure of the response curve, black level noise.black_level_dn contained in it):
///   light = (z - offset - dark_rate * t) / flat
struct SensorMaps {
  int width = 0;
  int height = 0;
  acquire::PixelLayout layout = acquire::PixelLayout::mono;
  std::vector<float> offset;      ///< fixed pattern of the black level, linearised DN, relative to NoiseModel::black_level_dn; empty: 0
  std::vector<float> dark_rate;   ///< mean dark signal, linearised DN per second; empty: noise.dark_current_e_per_s / gain for all
  std::vector<float> flat;        ///< sensitivity relative to the mean of its channel (1); empty: 1
  double flat_sigma = 0;          ///< relative standard error of one entry of `flat`
  std::vector<std::uint8_t> bad;  ///< 1: hot, dead or erratic value, its measurement is invalid; empty: none
  double offset_sigma = 0;        ///< standard error of one entry of `offset`, linearised DN
  double dark_rate_sigma = 0;     ///< standard error of one entry of `dark_rate`, linearised DN per second

  /// No map at all: every value is as NoiseModel says.
  bool empty() const { return offset.empty() && dark_rate.empty() && flat.empty() && bad.empty(); }
  /// Values a full map has: width * height * values_per_pixel(layout), 0 where the size is not positive.
  std::size_t n_values() const;
  /// Throws Error{input} naming the field: a map of the wrong size, a number that is not finite or out of range (flat > 0 where not
  /// bad, bad 0 or 1, sigmas >= 0).
  void validate() const;
  /// validate(), and Error{input} where frames of this size and layout cannot be corrected with these maps.
  void validate(int frame_width, int frame_height, acquire::PixelLayout frame_layout) const;
};

/// EXR, uncompressed float. Channels per colour C in {R, G, B} or {Y}: C.offset, C.dark_rate, C.flat, C.bad (0 or 1), those that are not
/// empty; attributes "lacquer.layout", "lacquer.maps_version", "lacquer.flat_sigma", "lacquer.offset_sigma", "lacquer.dark_rate_sigma".
/// The reader treats the file as hostile: sizes are checked before allocation. Error{file} naming file and field.
void write_sensor_maps(const std::filesystem::path& file, const SensorMaps& maps);
SensorMaps read_sensor_maps(const std::filesystem::path& file);

}  // namespace lacquer::calib
