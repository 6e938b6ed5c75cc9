#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "libacquire/frame.h"

namespace lacquer::calib {

/// Why a radiance value is not an ordinary measurement.
enum class PixelFlag : std::uint8_t {
  valid = 0,
  clipped = 1,  ///< saturated in every exposure: the true radiance is AT LEAST `radiance`
  dark = 2,     ///< never above the noise floor: value (possibly negative) and variance are kept
  invalid = 3,  ///< hot or dead pixel, or no data
};

/// Linear radiance of one view in the mosaic's own geometry (a mosaic is never interpolated).
/// Unit: DN of a linear sensor per second above black, divided by nothing; the radiometric scale is applied by the samples.
struct RadianceImage {
  int width = 0;
  int height = 0;
  acquire::PixelLayout layout = acquire::PixelLayout::mono;
  std::vector<float> radiance;   ///< width * height * values_per_pixel, row-major, rgb interleaved
  std::vector<float> variance;   ///< same shape, variance of radiance
  std::vector<PixelFlag> flags;  ///< same shape
};

/// EXR, half-free: channels R/G/B or Y, each with .variance (float) and .flag (uint); attributes "lacquer.layout", "lacquer.version".
/// Compression: none or ZIP as measured best; stated in the .cpp.
void write_radiance(const std::filesystem::path& file, const RadianceImage& image);
RadianceImage read_radiance(const std::filesystem::path& file);

}  // namespace lacquer::calib
