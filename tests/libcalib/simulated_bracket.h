#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <random>
#include <vector>

#include "libacquire/frame.h"
#include "libcalib/noise_model.h"
#include "libcalib/radiance_image.h"

/// A sensor written down independently of libacquire's simulated camera: photons -> electrons -> curve -> rounding -> clipping.
namespace lacquer::test {

struct SensorTruth {
  int bits = 12;
  double black = 64;
  double gain = 2;                ///< electrons per linearised DN
  double read_noise = 5;          ///< electrons
  double dark_current = 0;        ///< electrons per second
  acquire::PixelLayout layout = acquire::PixelLayout::mono;
  /// Raw value above black, not rounded, of a linearised DN; must be increasing.
  std::function<double(double)> curve = [](double e) { return e; };
};

/// Power law through (0, 0) and the gauge point of libcalib's ResponseCurve: value 2^(bits-1) has exposure 2^(bits-1) - black.
inline std::function<double(double)> gamma_curve(int bits, double black, double gamma) {
  const double mid = std::exp2(bits - 1) - black;
  return [=](double e) { return e > 0 ? mid * std::pow(e / mid, 1 / gamma) : e; };
}

/// `radiance`: linearised DN per second, one per value of a frame.
inline std::vector<acquire::RawFrame> simulate_bracket(const SensorTruth& sensor, int width, int height,
                                                       const std::vector<double>& radiance, const std::vector<double>& times,
                                                       unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  const double top = std::exp2(sensor.bits) - 1;
  std::vector<acquire::RawFrame> frames;
  for (const double t : times) {
    acquire::RawFrame f{width, height, sensor.layout, sensor.bits, {}, {t, 0}};
    f.data.reserve(radiance.size());
    for (const double r : radiance) {
      const double mean_e = (r * sensor.gain + sensor.dark_current) * t;
      // std::poisson_distribution is slow at large means, where it is normal to 1e-3 anyway.
      const double electrons = mean_e > 1000 ? std::round(mean_e + std::sqrt(mean_e) * normal(random))
                                             : (mean_e > 0 ? std::poisson_distribution<int>(mean_e)(random) : 0);
      const double linear = (electrons + sensor.read_noise * normal(random)) / sensor.gain;
      const double v = sensor.black + sensor.curve(linear);
      f.data.push_back(static_cast<std::uint16_t>(std::clamp(std::round(v), 0.0, top)));
    }
    frames.push_back(std::move(f));
  }
  return frames;
}

/// Radiances spread evenly in the logarithm between two limits.
inline std::vector<double> log_uniform(std::size_t n, double low, double high, unsigned seed) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> uniform(std::log(low), std::log(high));
  std::vector<double> radiance(n);
  for (double& r : radiance) r = std::exp(uniform(random));
  return radiance;
}

/// n exposure times, each `ratio` times the one before.
inline std::vector<double> time_series(double first, double ratio, int n) {
  std::vector<double> times;
  for (int i = 0; i < n; ++i) times.push_back(first * std::pow(ratio, i));
  return times;
}

/// 0.25 .. 328 ms, the series of Günther et al. 2005.
inline std::vector<double> paper_times() { return time_series(0.25e-3, std::pow(328 / 0.25, 1.0 / 15), 16); }

/// The noise of a sensor as the library states it.
inline calib::NoiseModel noise_of(const SensorTruth& s) {
  calib::NoiseModel n;
  n.black_level_dn = s.black;
  n.gain_e_per_dn = s.gain;
  n.read_noise_e = s.read_noise;
  n.dark_current_e_per_s = s.dark_current;
  return n;
}

/// Every byte of radiance and variance, and the flags.
inline void expect_same_bytes(const calib::RadianceImage& a, const calib::RadianceImage& b) {
  ASSERT_EQ(a.radiance.size(), b.radiance.size());
  EXPECT_EQ(0, std::memcmp(a.radiance.data(), b.radiance.data(), a.radiance.size() * sizeof(float)));
  EXPECT_EQ(0, std::memcmp(a.variance.data(), b.variance.data(), a.variance.size() * sizeof(float)));
  EXPECT_EQ(a.flags, b.flags);
}

}  // namespace lacquer::test
