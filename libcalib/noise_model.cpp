#include "libcalib/noise_model.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "libbrdf/error.h"
#include "libcalib/bracket_samples.h"

namespace lacquer::calib {

namespace {

/// Two values of one pixel at neighbouring exposure times, as radiances, squared difference per signal level.
struct PairBin {
  std::vector<double> squared_difference;  ///< (e_a / t_a - e_b / t_b)^2
  double z_a = 0, z_b = 0;                 ///< sums of the predicted exposures, then their means
  double quantisation = 0;                 ///< sum, then mean of slope_a^2 / 12 / t_a^2 + slope_b^2 / 12 / t_b^2
  double t_a = 0, t_b = 0;
};

/// Mean of the smaller three quarters of chi-square variables with one degree of freedom, 1 - 2 q phi(q) / 0.75 with q = 1.1503: turns
/// a trimmed mean of squares into a variance. Unlike the median it does not jump between the few differences that whole DN allow.
constexpr double trimmed_chi_square_mean = 0.3684;
constexpr std::size_t min_pairs = 40;  ///< per bin: its variance is then known to 30 %
constexpr int bins_per_octave = 2;
constexpr int n_octaves = 18;

double slope_at(const std::vector<double>& exposure, std::size_t v) {
  const std::size_t low = v > 0 ? v - 1 : v, high = std::min(v + 1, exposure.size() - 1);
  return (exposure[high] - exposure[low]) / static_cast<double>(high - low);
}

void collect_pairs(const BracketSamples& samples, std::size_t channel, const std::vector<double>& exposure,
                   std::vector<PairBin>& bins) {
  const SampledPixels& pixels = samples.channels[channel];
  for (std::size_t i = 0; i < pixels.n_pixels(); ++i) {
    for (std::size_t k = pixels.first[i]; k + 1 < pixels.first[i + 1]; ++k) {
      const Observation a = pixels.observations[k], b = pixels.observations[k + 1];
      const double t_a = samples.times[a.time], t_b = samples.times[b.time];
      const double e_a = exposure[a.value], e_b = exposure[b.value];
      const double radiance = (e_a + e_b) / (t_a + t_b);
      const int level = static_cast<int>(std::floor(bins_per_octave * std::log2(std::max(radiance * t_b, 1e-3))));
      if (level < 0 || level >= bins_per_octave * n_octaves) continue;
      PairBin& bin = bins[a.time * static_cast<std::size_t>(bins_per_octave * n_octaves) + static_cast<std::size_t>(level)];
      const double difference = e_a / t_a - e_b / t_b;
      const double s_a = slope_at(exposure, a.value) / t_a, s_b = slope_at(exposure, b.value) / t_b;
      bin.squared_difference.push_back(difference * difference);
      bin.z_a += radiance * t_a;
      bin.z_b += radiance * t_b;
      bin.quantisation += (s_a * s_a + s_b * s_b) / 12;
      bin.t_a = t_a;
      bin.t_b = t_b;
    }
  }
}

/// One equation per bin: variance = x[0] + x[1] z + x[2] z^2, divided by the measured variance so that all bins count alike
/// (a bin's relative error depends only on its number of pairs).
struct Equation {
  std::array<double, 3> row;
  double weight;
  double target;
  double lowest, highest;  ///< mean exposures of the shorter and the longer frame
  double limit;            ///< exposure of the channel at saturation
};

/// Values within this many sigmas of saturation, or of 0 where nothing below 0 is kept, are cut off: their scatter is too small.
constexpr double cut_off_sigmas = 4;

std::vector<Equation> equations(std::vector<PairBin>& bins, double limit) {
  std::vector<Equation> result;
  for (PairBin& bin : bins) {
    const std::size_t n = bin.squared_difference.size();
    if (n < min_pairs) continue;
    const std::size_t kept = n * 3 / 4;
    const auto end = bin.squared_difference.begin() + static_cast<std::ptrdiff_t>(kept);
    std::nth_element(bin.squared_difference.begin(), end, bin.squared_difference.end());
    const double trimmed_mean = std::accumulate(bin.squared_difference.begin(), end, 0.0) / static_cast<double>(kept);
    const double count = static_cast<double>(n), quantisation = bin.quantisation / count;
    const double z_a = bin.z_a / count, z_b = bin.z_b / count;
    const double inverse_a = 1 / (bin.t_a * bin.t_a), inverse_b = 1 / (bin.t_b * bin.t_b);
    // Less than quantisation gives is chance or a lattice of few differences.
    const double variance = std::max(trimmed_mean / trimmed_chi_square_mean, quantisation);
    result.push_back({{(inverse_a + inverse_b) / variance, (z_a * inverse_a + z_b * inverse_b) / variance,
                       (z_a * z_a * inverse_a + z_b * z_b * inverse_b) / variance},
                      // Rounding alone is no normal noise, and says nothing of the other parts.
                      std::min(count, 2000.0) * std::pow(std::max(1 - quantisation / variance, 0.02), 2),
                      1 - quantisation / variance,
                      z_a,
                      z_b,
                      limit});
  }
  return result;
}

/// Least squares with x >= 0 by cyclic coordinate descent: three unknowns, convex, so this is simple and converges.
std::array<double, 3> solve_nonnegative(const std::vector<Equation>& equations) {
  std::array<double, 3> x{0, 0, 0};
  std::array<std::array<double, 3>, 3> normal{};
  std::array<double, 3> right{};
  for (const Equation& e : equations)
    for (std::size_t i = 0; i < 3; ++i) {
      right[i] += e.weight * e.row[i] * e.target;
      for (std::size_t k = 0; k < 3; ++k) normal[i][k] += e.weight * e.row[i] * e.row[k];
    }
  for (int iteration = 0; iteration < 20000; ++iteration) {
    double change = 0;
    for (std::size_t i = 0; i < 3; ++i) {
      if (normal[i][i] <= 0) continue;
      double rest = right[i];
      for (std::size_t k = 0; k < 3; ++k)
        if (k != i) rest -= normal[i][k] * x[k];
      const double updated = std::max(rest / normal[i][i], 0.0);
      change = std::max(change, std::abs(updated - x[i]) * std::sqrt(normal[i][i]));
      x[i] = updated;
    }
    if (change < 1e-10) break;
  }
  return x;
}

/// Leaves out what is cut off according to the solution so far, until that stays. Where hardly anything is left, all is used.
std::array<double, 3> solve_uncut(const std::vector<Equation>& all, bool floor_clips) {
  std::array<double, 3> x = solve_nonnegative(all);
  constexpr int max_rounds = 20;
  std::size_t n_before = all.size();
  for (int round = 0; round < max_rounds; ++round) {
    const auto sigma = [&](double z) { return std::sqrt(x[0] + (x[1] + x[2] * z) * z); };
    std::vector<Equation> kept;
    for (const Equation& e : all) {
      const bool dark = floor_clips && e.lowest < cut_off_sigmas * sigma(e.lowest);
      if (!dark && e.highest + cut_off_sigmas * sigma(e.highest) < e.limit) kept.push_back(e);
    }
    if (kept.size() < 6) return solve_nonnegative(all);
    x = solve_nonnegative(kept);
    if (kept.size() == n_before) break;
    n_before = kept.size();
  }
  return x;
}

/// Lowest value from which on values contradict the next shorter exposure of their pixels: the median of the squared difference, in units
/// of its variance, is more than four times that of the normal distribution.
int contradicting_value(const BracketSamples& samples, const Response& response, const NoiseModel& noise) {
  constexpr int n_parts = 64;  // of the range; only the upper half is looked at
  constexpr double normal_median_square = 0.4549, largest_ratio = 4;
  const int saturation = saturation_value(noise, response.bits), size = std::max(1, (1 << response.bits) / n_parts);
  std::vector<std::vector<double>> parts(n_parts);
  for (std::size_t channel = 0; channel < samples.channels.size(); ++channel) {
    const SampledPixels& pixels = samples.channels[channel];
    const std::vector<double>& exposure = response.curves[channel].exposure;
    const auto variance = [&](std::size_t v) {
      const double z = std::max(exposure[v], 0.0), slope = slope_at(exposure, v);
      return (noise.read_noise_e * noise.read_noise_e / noise.gain_e_per_dn + z) / noise.gain_e_per_dn + std::pow(noise.relative_noise * z, 2) +
             slope * slope / 12;
    };
    for (std::size_t i = 0; i < pixels.n_pixels(); ++i)
      for (std::size_t k = pixels.first[i]; k + 1 < pixels.first[i + 1]; ++k) {
        const Observation a = pixels.observations[k], b = pixels.observations[k + 1];
        const int part = (saturation - 1 - b.value) / size;
        if (part >= n_parts / 2 || b.value >= saturation) continue;
        const double ratio = samples.times[b.time] / samples.times[a.time], difference = exposure[b.value] - exposure[a.value] * ratio;
        parts[static_cast<std::size_t>(part)].push_back(difference * difference / (variance(b.value) + ratio * ratio * variance(a.value)));
      }
  }
  int value = saturation;
  for (std::vector<double>& squares : parts) {
    if (squares.size() < min_pairs) break;
    const auto middle = squares.begin() + static_cast<std::ptrdiff_t>(squares.size() / 2);
    std::nth_element(squares.begin(), middle, squares.end());
    if (*middle < largest_ratio * normal_median_square) break;
    value -= size;
  }
  return value;
}

}  // namespace

void NoiseModel::validate() const {
  const auto check = [](const char* name, double value, double min, double max) {
    if (!(value >= min && value <= max))
      throw Error(ErrorCode::input, fmt::format("noise model: {}: expected a number in [{}, {}], got {}", name, min, max, value));
  };
  check("black_level_dn", black_level_dn, 0, 65535);
  check("gain_e_per_dn", gain_e_per_dn, 1e-9, 1e9);
  check("read_noise_e", read_noise_e, 0, 1e9);
  check("dark_current_e_per_s", dark_current_e_per_s, 0, 1e9);
  check("saturation_dn", saturation_dn, 0, 65535);
  check("relative_noise", relative_noise, 0, 1);
}

int saturation_value(const NoiseModel& noise, int bits) {
  const int top = (1 << bits) - 1;
  if (!(noise.saturation_dn > 0) || noise.saturation_dn > top) return top;
  return static_cast<int>(std::ceil(noise.saturation_dn));
}

NoiseModel estimate_noise(std::span<const std::vector<acquire::RawFrame>> brackets, const Response& response, const NoiseModel& known) {
  SamplingOptions sampling;
  sampling.lowest_value = known.black_level_dn > 0 ? 0 : 1;
  sampling.saturation_value = saturation_value(known, response.bits);
  const BracketSamples samples = sample_brackets(brackets, sampling);
  NoiseModel noise = estimate_noise(samples, response, known);
  if (const int value = contradicting_value(samples, response, noise); value < sampling.saturation_value) noise.saturation_dn = value;
  return noise;
}

NoiseModel estimate_noise(const BracketSamples& samples, const Response& response, const NoiseModel& known) {
  std::vector<Equation> all;
  for (std::size_t channel = 0; channel < samples.channels.size(); ++channel) {
    std::vector<PairBin> bins(samples.times.size() * static_cast<std::size_t>(bins_per_octave * n_octaves));
    collect_pairs(samples, channel, response.curves[channel].exposure, bins);
    const auto saturation = static_cast<std::size_t>(saturation_value(known, response.bits));
    const std::vector<Equation> part = equations(bins, response.curves[channel].exposure[saturation]);
    all.insert(all.end(), part.begin(), part.end());
  }
  const auto [read_variance, shot, relative_variance] = solve_uncut(all, !(known.black_level_dn > 0));
  NoiseModel noise = known;
  noise.dark_current_e_per_s = 0;
  noise.gain_e_per_dn = 1 / std::max(shot, 1e-6);  // 1e6 e/DN: shot noise far below quantisation, that is none
  noise.read_noise_e = std::sqrt(read_variance) * noise.gain_e_per_dn;
  noise.relative_noise = std::min(std::sqrt(relative_variance), 1.0);
  return noise;
}

}  // namespace lacquer::calib
