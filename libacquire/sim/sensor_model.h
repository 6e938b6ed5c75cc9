#pragma once

#include <cstdint>
#include <vector>

#include "libacquire/rig_description.h"

namespace lacquer::acquire::sim {

/// Light on the sensor: radiance in W m^-2 sr^-1, lens losses included, one plane per channel (1: Y, 3: R G B), each row-major.
struct RadianceImage {
  int width = 0;
  int height = 0;
  int n_channels = 0;
  std::vector<float> data;

  RadianceImage() = default;
  RadianceImage(int width, int height, int n_channels)
      : width(width), height(height), n_channels(n_channels),
        data(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * static_cast<std::size_t>(n_channels)) {}
  std::size_t index(int channel, int x, int y) const {
    return (static_cast<std::size_t>(channel) * static_cast<std::size_t>(height) + static_cast<std::size_t>(y)) *
               static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
  }
  float& at(int channel, int x, int y) { return data[index(channel, x, y)]; }
  float at(int channel, int x, int y) const { return data[index(channel, x, y)]; }
};

/// Sensor after EMVA 1288 (linear model, sections 2.1-2.3): photons to electrons with shot noise, dark current, full well, read noise,
/// gain, response, black level, quantisation and clipping.
///
///   mean electrons = radiance * sensitivity * t * (1 + prnu_i) + dark_current_i * t
///   electrons      = min(Poisson(mean), full well) + read_noise * N(0, 1) + offset_i
///   x              = electrons / gain * 10^(gain_db / 20)                        linear DN above black
///   DN             = black + x                                                   linear response
///   DN             = black + (max - black) * (x / (max - black))^(1 / gamma)     curved response, odd in x; max = 2^bits - 1
///   value          = DN rounded to the nearest integer, clipped to [0, max]
///
/// Response::estimate has the gamma response too: it only tells the pipeline not to know. A radiance below 0 (noise of a measured BRDF) gives no electrons.
class SensorModel {
 public:
  /// `flaws`: the part that differs from value to value i; it depends on `seed` and i alone.
  SensorModel(const SensorDescription& sensor, int width, int height, const SensorFlaws& flaws = {}, std::uint64_t seed = 0);

  /// One exposure. `light`: factor on the image's radiance (0: lights off). `key`: the frame's noise; equal keys, equal frames.
  RawFrame expose(const RadianceImage& image, double light, const CaptureSettings& settings, std::uint64_t key) const;

  /// Electrons of one pixel after full well and read noise. Poisson exactly for small means; above, the normal distribution with the
  /// third cumulant corrected (Cornish-Fisher), which is within 1e-3 of the Poisson distribution function.
  double electrons(double mean, std::uint64_t key, std::uint64_t index) const;

  /// Value of `x`, linear DN above black.
  std::uint16_t value(double x) const;

  /// The truth about each value, for tests and pictures: as `expose` uses it.
  double relative_sensitivity(std::size_t i) const { return relative_sensitivity_.empty() ? 1 : static_cast<double>(relative_sensitivity_[i]); }
  double dark_current(std::size_t i) const { return dark_current_.empty() ? sensor_.dark_current_e_per_s : static_cast<double>(dark_current_[i]); }
  double offset(std::size_t i) const { return offset_.empty() ? 0 : static_cast<double>(offset_[i]); }

 private:
  SensorDescription sensor_;
  int width_, height_;
  double max_dn_;
  std::vector<float> relative_sensitivity_;  ///< of each value; empty: 1
  std::vector<float> dark_current_;          ///< electrons per second; empty: that of the description
  std::vector<float> offset_;                ///< electrons; empty: 0
  double always_room_;  ///< mean electrons up to which 8 sigma of shot noise stay below the full well
};

}  // namespace lacquer::acquire::sim
