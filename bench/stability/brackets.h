#pragma once

#include <cmath>
#include <random>

#include "bench/radiometry/stack.h"
#include "libcalib/merge.h"

/// Brackets for the hard cases of response and merge.
namespace lacquer::bench {

/// Light spread evenly in the logarithm; fractions of full scale per second.
inline Scene log_uniform(int width, int height, double low, double high, unsigned seed) {
  std::mt19937_64 random(seed);
  Scene s{width, height, std::vector<double>(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * 3)};
  for (double& l : s.light) l = low * std::pow(high / low, static_cast<double>(random() >> 11) * 0x1p-53);
  return s;
}

/// One value per pixel.
inline acquire::RawFrame mono(int width, int height, double time_s, std::vector<std::uint16_t> data, int bits = 8) {
  return {width, height, acquire::PixelLayout::mono, bits, std::move(data), {time_s, 0}};
}

}  // namespace lacquer::bench
