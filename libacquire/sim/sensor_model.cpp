#include "libacquire/sim/sensor_model.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <limits>

#include "libacquire/sim/noise.h"

namespace lacquer::acquire::sim {

namespace {

/// Purposes of random numbers, so that no two share a stream.
enum Stream : std::uint64_t { sensitivity_flaw = 1, dark_flaw, hot_flaw, dead_flaw, offset_flaw };

constexpr double largest_exact_mean = 20;  // electrons; the sum over probabilities costs about 3 ns per electron

/// Electrons of Poisson(mean) plus a normal number of variance `read_variance`, from the standard normal number `z`: normal with the
/// third cumulant (which is `mean`) corrected, Cornish and Fisher 1938, first term.
double approximate_electrons(double mean, double read_variance, double z) {
  const double variance = mean + read_variance;
  return mean + std::sqrt(variance) * z + mean / variance * (z * z - 1) / 6;
}

}  // namespace

SensorModel::SensorModel(const SensorDescription& sensor, int width, int height, const SensorFlaws& flaws, std::uint64_t seed)
    : sensor_(sensor), width_(width), height_(height), max_dn_(static_cast<double>((1 << sensor.bits) - 1)) {
  const double root = std::sqrt(16 + sensor.full_well_e) - 4;  // root of m = full well - 8 sqrt(m)
  always_room_ = sensor.full_well_e > 0 ? root * root : std::numeric_limits<double>::infinity();

  const std::size_t n = static_cast<std::size_t>(width) * static_cast<std::size_t>(height) *
                        static_cast<std::size_t>(values_per_pixel(sensor.layout));
  const auto draw = [n](std::vector<float>& map, const auto& value) {
    map.resize(n);
    tbb::parallel_for(std::size_t{0}, n, [&](std::size_t i) { map[i] = static_cast<float>(value(i)); });
  };
  const std::uint64_t gain_key = combine(seed, sensitivity_flaw), dark_key = combine(seed, dark_flaw), hot_key = combine(seed, hot_flaw);
  const std::uint64_t dead_key = combine(seed, dead_flaw), offset_key = combine(seed, offset_flaw);
  if (flaws.prnu > 0 || flaws.dead_pixels > 0)
    draw(relative_sensitivity_, [&](std::size_t i) {
      return uniform(dead_key, i) < flaws.dead_pixels ? 0 : std::max(1 + flaws.prnu * normal(gain_key, i), 0.0);
    });
  if (flaws.dsnu_e > 0) draw(offset_, [&](std::size_t i) { return flaws.dsnu_e * normal(offset_key, i); });
  if (flaws.dark_nonuniformity > 0 || flaws.hot_pixels > 0) {
    const double log_variance = std::log1p(flaws.dark_nonuniformity * flaws.dark_nonuniformity);  // then the mean stays the nominal one
    draw(dark_current_, [&](std::size_t i) {
      const double hot = uniform(hot_key, i) / std::max(flaws.hot_pixels, 1e-300);  // below 1: hot, and then uniform in (0, 1)
      if (hot < 1) return std::max(sensor_.dark_current_e_per_s, 1.0) * 300 * std::pow(10.0, hot);
      return sensor_.dark_current_e_per_s * std::exp(std::sqrt(log_variance) * normal(dark_key, i) - log_variance / 2);
    });
  }
}

double SensorModel::electrons(double mean, std::uint64_t key, std::uint64_t index) const {
  const double full_well = sensor_.full_well_e, read = sensor_.read_noise_e;
  const auto add_read_noise = [&](double e) { return read > 0 ? e + read * normal(~key, index) : e; };
  const bool may_fill = mean > always_room_;
  if (mean <= 0) return add_read_noise(0);
  if (mean <= largest_exact_mean) {
    const double shot = poisson_quantile(mean, uniform(key, index));
    return add_read_noise(may_fill ? std::min(shot, full_well) : shot);
  }
  const double z = normal(key, index);
  if (!may_fill) return approximate_electrons(mean, read * read, z);  // one draw for both noises: their sum has this distribution
  return add_read_noise(std::min(approximate_electrons(mean, 0, z), full_well));
}

std::uint16_t SensorModel::value(double x) const {
  double dn = x;
  if (sensor_.response != SensorDescription::Response::linear && sensor_.gamma != 1) {
    const double range = max_dn_ - sensor_.black_level_dn;
    dn = std::copysign(range * std::pow(std::abs(x) / range, 1 / sensor_.gamma), x);
  }
  return static_cast<std::uint16_t>(std::clamp(dn + sensor_.black_level_dn, 0.0, max_dn_) + 0.5);
}

RawFrame SensorModel::expose(const RadianceImage& image, double light, const CaptureSettings& settings, std::uint64_t key) const {
  assert(image.width == width_ && image.height == height_ && image.n_channels == n_channels(sensor_.layout));
  const int n_values = values_per_pixel(sensor_.layout);
  RawFrame frame{.width = width_, .height = height_, .layout = sensor_.layout, .bits = sensor_.bits, .data = {}, .actual = settings};
  const std::size_t row_length = static_cast<std::size_t>(width_) * static_cast<std::size_t>(n_values);
  frame.data.resize(row_length * static_cast<std::size_t>(height_));

  const glm::dvec3 electrons_per_radiance = sensor_.sensitivity * (settings.exposure_s * light);
  const double dn_per_electron = std::pow(10.0, settings.gain_db / 20) / sensor_.gain_e_per_dn;

  std::array<std::array<int, 3>, 4> channels{};  // of the values of a pixel at (x & 1, y & 1): mosaics repeat every 2 x 2 pixels
  for (int i = 0; i < 4; ++i)
    for (int k = 0; k < n_values; ++k) channels[static_cast<std::size_t>(i)][static_cast<std::size_t>(k)] = channel_of(sensor_.layout, i & 1, i >> 1, k);

  tbb::parallel_for(tbb::blocked_range<int>(0, height_, 8), [&](const tbb::blocked_range<int>& rows) {
    for (int y = rows.begin(); y != rows.end(); ++y) {
      std::size_t at = row_length * static_cast<std::size_t>(y);
      std::array<const float*, 3> row{};
      for (int c = 0; c < image.n_channels; ++c) row[static_cast<std::size_t>(c)] = image.data.data() + image.index(c, 0, y);
      for (int x = 0; x < width_; ++x) {
        for (int k = 0; k < n_values; ++k, ++at) {
          const auto channel = static_cast<std::size_t>(channels[static_cast<std::size_t>((x & 1) + 2 * (y & 1))][static_cast<std::size_t>(k)]);
          const double signal = static_cast<double>(row[channel][x]) * electrons_per_radiance[static_cast<int>(channel)];
          const double mean = std::max(signal, 0.0) * relative_sensitivity(at) + dark_current(at) * settings.exposure_s;
          frame.data[at] = value((electrons(mean, key, at) + offset(at)) * dn_per_electron);
        }
      }
    }
  });
  return frame;
}

}  // namespace lacquer::acquire::sim
