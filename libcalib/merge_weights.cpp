#include "libcalib/merge_weights.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace lacquer::calib {

namespace {

constexpr int max_octaves = 48;
/// Bins start where the variance of the longest exposure has risen by this fraction over that of darkness: weights hardly change below.
constexpr double rise_at_first_bin = 0.02;
/// Of the diagonal: sums of one or two exposures, or of equal times, are linearly dependent.
constexpr double ridge = 1e-9;

constexpr int quantisation_bits = 5, quantisation_steps = 1 << quantisation_bits, quantisation_min_exponent = -20, quantisation_octaves = 44;

}  // namespace

std::array<double, n_sums> time_basis(double exposure_s) { return {1.0, std::sqrt(exposure_s), exposure_s}; }

QuantisationNoise::QuantisationNoise(const std::vector<double>& exposure) : variance_(quantisation_octaves * quantisation_steps) {
  std::size_t above = 1;
  for (std::size_t i = 0; i < variance_.size(); ++i) {
    const double step = static_cast<double>(i % quantisation_steps) + 0.5;
    const double z = std::ldexp(1 + step / quantisation_steps, quantisation_min_exponent + static_cast<int>(i / quantisation_steps));
    while (above + 1 < exposure.size() && exposure[above] < z) ++above;
    const double slope = exposure[above] - exposure[above - 1];
    variance_[i] = static_cast<float>(slope * slope / 12);
  }
}

double QuantisationNoise::operator()(double z) const {
  const int bits = std::bit_cast<std::int32_t>(static_cast<float>(z));
  const int index = (bits >> (23 - quantisation_bits)) - ((127 + quantisation_min_exponent) << quantisation_bits);
  return variance_[static_cast<std::size_t>(std::clamp(index, 0, quantisation_octaves * quantisation_steps - 1))];
}

/// Of the sums over a set of exposures: covariance (lower triangle) at one radiance, and sum b t.
struct MergeWeights::Moments {
  std::array<std::array<double, n_sums>, n_sums> covariance{};
  std::array<double, n_sums> time{};
};

MergeWeights::MergeWeights(const std::vector<ExposureNoise>& exposures, const std::vector<QuantisationNoise>& curves,
                           const NoiseModel& noise, double largest)
    : exposures_(exposures), curves_(curves), shot_(1 / noise.gain_e_per_dn), relative2_(noise.relative_noise * noise.relative_noise) {
  std::size_t longest = 0;
  for (std::size_t j = 0; j < exposures_.size(); ++j) {
    basis_.push_back(time_basis(exposures_[j].time));
    if (exposures_[j].time > exposures_[longest].time) longest = j;
  }
  double smallest = largest;
  const auto bright = [&](double x) {
    for (std::size_t c = 0; c < n_channels(); ++c)
      if (exposure_variance(c, longest, x * exposures_[longest].time) >= (1 + rise_at_first_bin) * exposure_variance(c, longest, 0)) return true;
    return false;
  };
  for (int octave = 0; octave < max_octaves && bright(smallest); ++octave) smallest /= 2;
  const auto bin_bits = [](double x) { return std::bit_cast<std::int32_t>(static_cast<float>(x)) >> MergeWeightTable::bin_shift; };
  bins_.n_exposures = static_cast<std::int32_t>(exposures_.size());
  bins_.first_bin = bin_bits(smallest);
  bins_.n_bins = bin_bits(largest) - bins_.first_bin + 2;
  const auto n_bins = static_cast<std::size_t>(bins_.n_bins);
  entries_.resize(n_channels() * exposures_.size() * n_bins);
  for (std::size_t c = 0; c < n_channels(); ++c)
    for (std::int32_t bin = 0; bin < bins_.n_bins; ++bin) {
      Moments moments;
      for (std::size_t j = 0; j < exposures_.size(); ++j) {
        add(moments, c, j, middle(bin));
        entries_[(c * exposures_.size() + j) * n_bins + static_cast<std::size_t>(bin)] = solve(moments, c, ~std::uint64_t{0} >> (63 - j), bin);
      }
    }
}

double MergeWeights::middle(std::int32_t bin) const {
  return (static_cast<double>(bins_.lower_edge(bin)) + static_cast<double>(bins_.lower_edge(bin + 1))) / 2;
}

double MergeWeights::exposure_variance(std::size_t channel, std::size_t j, double z) const {
  const double variance = exposures_[j].constant + (shot_ + relative2_ * z) * z;
  return curves_.empty() ? variance : variance + curves_[channel](z);
}

void MergeWeights::add(Moments& m, std::size_t channel, std::size_t j, double x) const {
  const double variance = exposure_variance(channel, j, x * exposures_[j].time);
  const auto& b = basis_[j];
  for (std::size_t k = 0; k < n_sums; ++k) {
    m.time[k] += b[k] * exposures_[j].time;
    for (std::size_t l = 0; l <= k; ++l) m.covariance[k][l] += b[k] * b[l] * variance;
  }
}

MergeWeight MergeWeights::solve(const Moments& m, std::size_t channel, std::uint64_t usable, std::int32_t bin) const {
  // Scaled to a unit diagonal; Cholesky; then a = C^-1 T / (T' C^-1 T).
  std::array<double, n_sums> scale{}, y{}, a{};
  std::array<std::array<double, n_sums>, n_sums> c{};
  for (std::size_t k = 0; k < n_sums; ++k) scale[k] = 1 / std::sqrt(m.covariance[k][k]);
  for (std::size_t k = 0; k < n_sums; ++k) {
    for (std::size_t l = 0; l <= k; ++l) {
      double sum = k == l ? 1 + ridge : m.covariance[k][l] * scale[k] * scale[l];
      for (std::size_t p = 0; p < l; ++p) sum -= c[k][p] * c[l][p];
      c[k][l] = k == l ? std::sqrt(std::max(sum, ridge / 4)) : sum / c[l][l];
    }
    y[k] = m.time[k] * scale[k];
    for (std::size_t p = 0; p < k; ++p) y[k] -= c[k][p] * y[p];
    y[k] /= c[k][k];
  }
  double total = 0;
  for (std::size_t k = n_sums; k-- > 0;) {
    for (std::size_t p = k + 1; p < n_sums; ++p) y[k] -= c[p][k] * y[p];
    y[k] /= c[k][k];
    a[k] = y[k] * scale[k];
    total += a[k] * m.time[k];
  }
  const double low = bins_.lower_edge(bin), high = bins_.lower_edge(bin + 1);
  double offset_gain = 0, at_low = 0, at_high = 0, dark = 0;
  for (std::size_t j = 0; j < exposures_.size(); ++j) {
    if (!(usable >> j & 1)) continue;
    double weight = 0;
    for (std::size_t k = 0; k < n_sums; ++k) weight += a[k] / total * basis_[j][k];
    const double t = exposures_[j].time;
    offset_gain += weight;
    at_low += weight * weight * exposure_variance(channel, j, low * t);
    at_high += weight * weight * exposure_variance(channel, j, high * t);
    dark += weight * weight * t * shot_;
  }
  const double slope = (at_high - at_low) / (high - low);
  MergeWeight w{};
  for (std::size_t k = 0; k < n_sums; ++k) w.a[k] = static_cast<float>(a[k] / total);
  w.offset_gain = static_cast<float>(offset_gain);
  w.variance0 = static_cast<float>(at_low - slope * low);
  w.variance1 = static_cast<float>(slope);
  w.variance_dark = static_cast<float>(dark);
  return w;
}

void MergeWeights::set_certain(std::size_t channel, std::int32_t count, float radiance) {
  const auto n_bins = static_cast<std::size_t>(bins_.n_bins);
  const std::size_t row = channel * exposures_.size() + static_cast<std::size_t>(count - 1);
  for (std::size_t bin = 0; bin < n_bins; ++bin) entries_[row * n_bins + bin].certain = radiance;
}

MergeWeight MergeWeights::of_set(std::size_t channel, std::uint64_t usable, float x) const {
  const std::int32_t bin = bins_.bin_of(x);
  Moments moments;
  for (std::size_t j = 0; j < exposures_.size(); ++j)
    if (usable >> j & 1) add(moments, channel, j, middle(bin));
  return solve(moments, channel, usable, bin);
}

double MergeWeights::prediction_time(std::uint64_t usable) const {
  double sum = 0;
  for (std::size_t j = 0; j < exposures_.size(); ++j)
    if (usable >> j & 1) sum += basis_[j].back() * exposures_[j].time;
  return sum;
}

}  // namespace lacquer::calib
