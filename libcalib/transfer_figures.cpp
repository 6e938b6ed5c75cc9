#include "libcalib/transfer_figures.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace lacquer::calib {

using Use = TransferPoint::Use;

namespace {

constexpr double significance = 3;  ///< standard errors

/// Square root of a variance that may be 0 or, by chance, below.
Measured root_of(double variance, double sigma) {
  const double root = std::sqrt(std::max(variance, 0.0));
  return {root, variance > sigma ? sigma / (2 * root) : std::sqrt(std::max(variance, 0.0) + sigma) - root};
}

bool gain_seen(const TransferMeasurement& m, const TransferLine& line) {
  return !m.flat_pairs().empty() && line.has_slope && line.slope > significance * std::sqrt(line.slope_variance);
}

/// Standard error that rounding of a noise too small to spread it adds to a mean: the first harmonic of the mean of rounded normal
/// numbers (Widrow and Kollar, "Quantization Noise", 2008, 4.2), at most the 1/12 of a value that never changes.
double rounding_error(double noise_variance) {
  const double harmonic = std::exp(-4 * std::pow(3.14159265358979323846, 2) * std::max(noise_variance, 0.0));
  return std::sqrt(harmonic / 12);
}

void add_dark_figures(const TransferMeasurement& m, std::size_t index, const TransferLine& line, NoiseFigures& f) {
  if (!m.darks_usable()) return;
  const DarkLine& dark = m.dark_lines()[index];
  const double spread = m.base_spread()[index].value;
  const std::vector<double>* curve = curve_of(m, index);
  const double rounding = curve ? 0 : rounding_error(line.constant + spread * spread);
  f.black_level_dn = Measured{curve ? raw_value(*curve, dark.base.value) : dark.base.value, std::hypot(dark.base.sigma, rounding)};
  f.dsnu_dn = m.base_spread()[index];
  if (!dark.rate) return;
  f.dark_current_dn_per_s = dark.rate;
  f.dark_spread_dn_per_s = m.rate_spread()[index];
  if (f.gain_e_per_dn) {
    const Measured g = *f.gain_e_per_dn, d = *dark.rate;
    f.dark_current_e_per_s = Measured{d.value * g.value, std::hypot(d.sigma * g.value, d.value * g.sigma)};
  }
}

}  // namespace

NoiseFigures noise_figures(const TransferMeasurement& m, std::size_t index) {
  NoiseFigures f;
  const TransferLine& line = m.lines()[index];
  f.chi_square = line.chi_square;
  f.degrees_of_freedom = line.degrees_of_freedom;
  if (line.constant_variance > 0) f.read_noise_dn = root_of(line.constant, std::sqrt(line.constant_variance));
  if (gain_seen(m, line)) {
    const double gain = 1 / line.slope;
    f.gain_e_per_dn = Measured{gain, gain * gain * std::sqrt(line.slope_variance)};
    // Electrons: constant / slope^2, errors of both and their covariance.
    const double electrons = line.constant * gain * gain;
    const double variance = gain * gain * gain * gain *
                            (line.constant_variance + 4 * line.constant * line.constant * gain * gain * line.slope_variance -
                             4 * line.constant * gain * line.covariance);
    f.read_noise_e = root_of(electrons, std::sqrt(std::max(variance, 0.0)));
  }
  if (line.has_square) f.relative_noise = root_of(line.square, std::sqrt(line.square_variance));
  add_dark_figures(m, index, line, f);
  if (m.flat()) f.prnu = m.flat_spread()[index];
  double weight = 0;
  for (const PairRecord& p : m.flat_pairs())
    for (std::size_t c = 0; c < p.statistics.size(); ++c) {
      if (p.use[c] == Use::clipped || (index < p.statistics.size() && index != c)) continue;
      f.noise_correlation += p.statistics[c].n * p.statistics[c].correlation;
      weight += p.statistics[c].n;
    }
  if (weight > 0) f.noise_correlation /= weight;
  return f;
}

std::optional<Measured> lamp_flicker(const TransferMeasurement& m) {
  double square = 0, noise = 0, n = 0;
  for (const PairRecord& p : m.flat_pairs()) {
    double log_ratio = 0, expected = 0, channels = 0;
    for (std::size_t c = 0; c < p.statistics.size(); ++c) {
      const PairStatistics& s = p.statistics[c];
      if (p.use[c] != Use::fitted) continue;
      log_ratio += std::log(s.ratio);
      expected += 2 * s.variance / (s.n * s.mean * s.mean);
      ++channels;
    }
    if (channels == 0) continue;
    square += std::pow(log_ratio / channels, 2) / 2;
    noise += expected / (channels * channels) / 2;
    ++n;
  }
  if (n < 2 || square < largest_by_chance(n, 10) * noise) return std::nullopt;
  return Measured{std::sqrt((square - noise) / n), std::sqrt(square / n / (2 * n))};
}

void find_saturation(const TransferMeasurement& m, PhotonTransfer& t) {
  const int top = (1 << t.bits) - 1;
  const TransferLine& line = m.lines().back();
  const PairStatistics* deepest = nullptr;
  double lowest_share = 0.5, full_dn = 0;  // share of the variance that the line says: well beyond the knee
  bool clipped = false;
  for (const PairRecord& p : m.flat_pairs())
    for (std::size_t c = 0; c < p.statistics.size(); ++c) {
      if (p.good(c)) continue;
      const PairStatistics& s = p.statistics[c];
      clipped = clipped || p.use[c] == Use::clipped;
      const double signal = s.mean + m.dark_signal().rate[c] * p.exposure_s;
      const double share = s.variance / (line.constant + line.slope * signal + s.quantisation);
      if (share >= lowest_share) continue;
      lowest_share = share;
      full_dn = signal;
      deepest = &s;
    }
  t.model.saturation_dn = top;
  if (m.options().saturation_dn > 0) {
    t.model.saturation_dn = std::min(m.options().saturation_dn, static_cast<double>(top));
    return;
  }
  if (!deepest) {
    if (!clipped && !m.flat_pairs().empty())
      t.notes.push_back(fmt::format("no flat reaches saturation: {} DN (the top of the range) is taken; brighter flats would tell", top));
    return;
  }
  if (deepest->clipped_share > 0.5) return;  // the converter's own end
  // Five sigma of what is left of the noise below the pile: a full value is then taken for a good one once in 3 million.
  t.model.saturation_dn = std::clamp(std::floor(deepest->raw_mean - 5 * deepest->raw_sigma), 1.0, static_cast<double>(top));
  if (t.all.gain_e_per_dn) {
    const Measured g = *t.all.gain_e_per_dn;
    t.full_well_e = Measured{full_dn * g.value, full_dn * g.sigma};
  }
  if (deepest->raw_sigma > 0.02 * deepest->raw_mean)
    t.notes.push_back(fmt::format("the saturated flats are not saturated everywhere: {} DN may be too low a limit; brighter flats would tell",
                                  t.model.saturation_dn));
}

/// Raw value whose exposure on `curve` is `exposure`, between whole values too.
double raw_value(const std::vector<double>& curve, double exposure) {
  const auto above = std::lower_bound(curve.begin(), curve.end(), exposure);
  if (above == curve.begin()) return 0;
  if (above == curve.end()) return static_cast<double>(curve.size() - 1);
  const auto v = static_cast<double>(above - curve.begin());
  return v - (*above - exposure) / (*above - *(above - 1));
}

const std::vector<double>* curve_of(const TransferMeasurement& m, std::size_t channel) {
  const auto& response = m.options().response;
  if (!response || response->linear) return nullptr;
  return &response->curves[std::min(channel, response->curves.size() - 1)].exposure;
}

}  // namespace lacquer::calib
