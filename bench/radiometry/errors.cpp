#include "bench/radiometry/errors.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

namespace lacquer::bench {

namespace {

/// Lowest raw value at which one value's signal is three times its noise.
int lowest_telling_level(const Sensor& s) {
  const double range = std::exp2(s.bits) - 1 - s.black_dn;
  for (int v = static_cast<int>(s.black_dn) + 1;; ++v) {
    const double electrons = s.full_well_e * s.curve.backward((v - s.black_dn) / range);
    if (electrons >= 3 * std::sqrt(electrons + s.read_noise_e * s.read_noise_e)) return v;
  }
}

}  // namespace

double quantile(std::vector<double> values, double q) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto nth = values.begin() + static_cast<std::ptrdiff_t>(q * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

std::vector<std::uint8_t> valid_values(const Stack& stack, const ReferenceImage& reference) {
  std::vector<std::uint8_t> valid(stack.truth.size());
  for (std::size_t i = 0; i < valid.size(); ++i) valid[i] = 100 * reference.variance[i] < stack.truth[i] * stack.truth[i];
  return valid;
}

RadianceError radiance_error(std::span<const float> radiance, const Stack& stack, std::span<const std::uint8_t> valid) {
  RadianceError error;
  std::array<std::vector<double>, 3> ratios;
  const double bound = stack.sensor.saturation_exposure() / stack.frames.front().actual.exposure_s;
  for (std::size_t i = 0; i < valid.size(); ++i)
    if (valid[i]) ratios[i % 3].push_back(std::isfinite(radiance[i]) ? radiance[i] / stack.truth[i] : std::numeric_limits<double>::infinity());
  std::vector<double> errors;
  for (std::size_t c = 0; c < 3; ++c) {
    error.scale[c] = quantile(ratios[c], 0.5);
    for (const double r : ratios[c]) {
      error.not_finite += !std::isfinite(r);
      errors.push_back(std::abs(r / error.scale[c] - 1));
    }
  }
  std::size_t below = 0;
  for (std::size_t i = 0; i < valid.size(); ++i) {
    if (stack.truth[i] < 1.2 * bound) continue;  // 20 sigma above clipping
    ++error.n_clipped;
    below += !(radiance[i] / error.scale[i % 3] > 0.5 * bound);
  }
  error.n = errors.size();
  error.median = quantile(errors, 0.5);
  error.percentile95 = quantile(errors, 0.95);
  error.clipped_below_bound = error.n_clipped ? static_cast<double>(below) / static_cast<double>(error.n_clipped) : 0;
  return error;
}

std::vector<LevelStatistics> standardised_errors(const calib::RadianceImage& image, const std::array<double, 3>& scale,
                                                 const Stack& stack, std::size_t min_n) {
  struct Sums {
    std::size_t n = 0;
    double sum = 0, square = 0;
  };
  std::map<int, Sums> decades;
  const double full = stack.sensor.saturation_exposure() / stack.frames.back().actual.exposure_s;
  for (std::size_t i = 0; i < stack.truth.size(); ++i) {
    if (image.flags[i] == calib::PixelFlag::clipped || image.flags[i] == calib::PixelFlag::invalid) continue;
    const double e = (image.radiance[i] - stack.truth[i] * scale[i % 3]) / std::sqrt(image.variance[i]);
    Sums& s = decades[static_cast<int>(std::floor(std::log10(stack.truth[i] / full)))];
    ++s.n, s.sum += e, s.square += e * e;
  }
  std::vector<LevelStatistics> levels;
  for (const auto& [decade, s] : decades) {
    if (s.n < min_n) continue;
    const double n = static_cast<double>(s.n), mean = s.sum / n;
    levels.push_back({static_cast<double>(decade), s.n, mean, std::sqrt(std::max(s.square / n - mean * mean, 0.0))});
  }
  return levels;
}

ResponseError response_error(const std::function<double(int, int)>& exposure, const Stack& stack, std::size_t min_count) {
  const int n_values = 1 << stack.sensor.bits, mid = n_values / 2;
  const auto truth = stack.sensor.response().curves[0].exposure;
  std::array<std::vector<std::size_t>, 3> counts;
  counts.fill(std::vector<std::size_t>(static_cast<std::size_t>(n_values)));
  for (const auto& f : stack.frames)
    for (std::size_t i = 0; i < f.data.size(); ++i) ++counts[i % 3][f.data[i]];
  ResponseError error;
  double square = 0;
  error.lowest = n_values;
  const int first = lowest_telling_level(stack.sensor);
  for (int c = 0; c < 3; ++c)
    for (int v = first; v < n_values - 1; ++v) {
      if (counts[static_cast<std::size_t>(c)][static_cast<std::size_t>(v)] < min_count) continue;
      const double e = std::log(exposure(c, v) / exposure(c, mid) * truth[static_cast<std::size_t>(mid)] / truth[static_cast<std::size_t>(v)]);
      square += e * e;
      error.largest = std::max(error.largest, std::abs(e));
      error.lowest = std::min(error.lowest, v);
      error.highest = std::max(error.highest, v);
      ++error.levels;
    }
  error.rms = std::sqrt(square / error.levels);
  return error;
}

}  // namespace lacquer::bench
