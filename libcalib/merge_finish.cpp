#include "libcalib/merge_finish.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

#include "libcalib/merge_kernels.h"

namespace lacquer::calib {

namespace {

/// A value clipped although the other exposures put it this many sigmas below the threshold contradicts them and is left out.
constexpr double bound_sigmas = 4;
/// On the other side, a value clipped that should be is worth nothing this many sigmas beyond: it moves the mean by 0.004 sigma.
constexpr double certain_sigmas = 3;
/// Radiances for which that is not quite clear are looked at in full.
constexpr double margin = 1.1;
/// Curves of more bits are kept as nodes, exact at every so many-th value and straight in between: 32 kB per channel.
constexpr int largest_whole_table_bits = 12;
/// Levels of a curve whose relative variance exceeds the best by this factor count as clipped.
constexpr double worst_relative_variance = 4;

/// phi(a) / Q(a) of the normal distribution: by how much a value known to lie above a exceeds its mean, in sigmas. Within 1e-7.
class MillsRatio {
 public:
  MillsRatio() {
    for (int i = 0; i <= n; ++i) nodes_[static_cast<std::size_t>(i)] = exact(lowest + i / per_unit);
  }
  double operator()(double a) const {
    if (!(a > lowest)) return 0;                 // below 1e-14
    if (a >= highest) return a + 1 / a;          // asymptote; erfc underflows near 37
    const double position = (a - lowest) * per_unit;
    const auto i = static_cast<std::size_t>(position);
    // Cubic through values and derivatives, which are lambda (lambda - a).
    const double u = position - static_cast<double>(i), w = 1 - u, low = nodes_[i], high = nodes_[i + 1], at = lowest + static_cast<double>(i) / per_unit;
    const double slope_low = low * (low - at) / per_unit, slope_high = high * (high - at - 1 / per_unit) / per_unit;
    return w * w * (low * (1 + 2 * u) + slope_low * u) + u * u * (high * (1 + 2 * w) - slope_high * w);
  }

 private:
  static constexpr double lowest = -8, highest = 24, per_unit = 16;
  static constexpr int n = static_cast<int>((highest - lowest) * per_unit);
  static double exact(double a) { return std::sqrt(2 / std::numbers::pi) * std::exp(-a * a / 2) / std::erfc(a / std::numbers::sqrt2); }
  std::array<double, n + 1> nodes_;
};

const MillsRatio mills_ratio;

/// Lowest value of a curve's shoulder on which a longer exposure tells hardly anything; `saturation` where there is none.
std::size_t shoulder(const std::vector<double>& exposure, std::size_t saturation, const NoiseModel& noise) {
  const double g = noise.gain_e_per_dn, read = noise.read_noise_e / g;
  double best = INFINITY;
  for (std::size_t v = 1; v < saturation; ++v) {
    const double z = exposure[v], slope = (exposure[v + 1] - exposure[v - 1]) / 2;
    if (!(z > 0)) continue;
    const double relative = (read * read + z / g + slope * slope / 12) / (z * z) + noise.relative_noise * noise.relative_noise;
    best = std::min(best, relative);
    if (relative > worst_relative_variance * best && 2 * v > saturation) return v;
  }
  return saturation;
}

}  // namespace

SensorTables::SensorTables(const Response& response, const NoiseModel& noise, double shortest_s)
    : linear_(response.linear),
      black_(static_cast<float>(-response.curves.front().exposure.front())),
      bits_(response.bits),
      node_shift_(std::max(0, response.bits - largest_whole_table_bits)),
      shortest_s_(shortest_s) {
  const auto saturation = static_cast<std::size_t>(saturation_value(noise, response.bits));
  for (const ResponseCurve& curve : response.curves) {
    const std::vector<double>& exposure = curve.exposure;
    const std::size_t top = linear_ ? saturation : shoulder(exposure, saturation, noise);
    const auto threshold_of = [&](std::size_t clipped) { return (exposure[clipped] + exposure[clipped - 1]) / 2; };
    channels_.push_back({threshold_of(top), threshold_of(saturation), static_cast<std::int32_t>(top), static_cast<std::int32_t>(saturation)});
    if (linear_) continue;
    quantisation_.emplace_back(exposure);
    const std::size_t step = std::size_t{1} << node_shift_;
    for (std::size_t v = 0; v < exposure.size(); v += step) {
      table_.push_back(static_cast<float>(exposure[v]));
      if (step == 1) continue;
      const std::size_t next = std::min(v + step, exposure.size() - 1);
      table_.push_back(static_cast<float>((exposure[next] - exposure[v]) / static_cast<double>(next - v)));
    }
  }
}

ValueMeaning SensorTables::meaning(const std::array<std::size_t, 3>& channels, std::size_t period) const {
  ValueMeaning m{linear_, black_, (std::uint32_t{1} << bits_) - 1, period, {}, node_shift_, {}};
  for (std::size_t i = 0; i < period; ++i) {
    const Channel& channel = channels_[channels[i]];
    m.clipped[0][i] = channel.clipped;
    m.clipped[1][i] = channel.shortest_clipped;
    m.tables[i] = table_.data() + channels[i] * (table_.size() / channels_.size());
  }
  return m;
}

MergeFinish::MergeFinish(const SensorTables& tables, const NoiseModel& noise, const std::vector<double>& times, const SensorMaps& maps)
    : times_(times),
      maps_(maps),
      dark_rate_(noise.dark_current_e_per_s / noise.gain_e_per_dn),
      by_time_(times.size()),
      ascending_(std::is_sorted(times.begin(), times.end())) {
  std::iota(by_time_.begin(), by_time_.end(), std::size_t{0});
  std::stable_sort(by_time_.begin(), by_time_.end(), [&](std::size_t a, std::size_t b) { return times[a] < times[b]; });
  const double g = noise.gain_e_per_dn;
  std::vector<ExposureNoise> exposures;
  for (const double t : times)
    exposures.push_back({t, (noise.read_noise_e * noise.read_noise_e + noise.dark_current_e_per_s * t) / (g * g) +
                                (tables.linear() ? 1.0 / 12 : 0.0)});
  double largest = 0;
  for (std::size_t channel = 0; channel < tables.n_channels(); ++channel)
    for (const double t : times) {
      threshold_.push_back(tables.threshold(channel, t));
      largest = std::max(largest, threshold_.back() / t);
    }
  weights_.emplace(exposures, tables.quantisation(), noise, 2 * largest);
  for (std::size_t n = 1; n <= times.size(); ++n)
    inverse_prediction_time_.push_back(static_cast<float>(1 / weights_->prediction_time(~std::uint64_t{0} >> (64 - n))));
  for (std::size_t channel = 0; channel < weights_->n_channels(); ++channel)
    for (std::size_t j = 0; j < times.size(); ++j)
      weights_->set_certain(channel, static_cast<std::int32_t>(j) + 1, certain_radiance(channel, j));
}

/// With the exposures up to j usable: radiance above which a clipped exposure j + 1 tells nothing more.
float MergeFinish::certain_radiance(std::size_t channel, std::size_t j) const {
  if (j + 1 == times_.size()) return -std::numeric_limits<float>::infinity();
  const double t = times_[j + 1], threshold = this->threshold(channel, j + 1) - dark_rate_ * t;
  const MergeWeightTable table = weights_->table();
  const auto x = static_cast<float>(threshold / t);
  const std::int32_t bin = table.bin_of(x);
  const double variance = table.variance(table.at(static_cast<std::int32_t>(channel), static_cast<std::int32_t>(j) + 1, bin), bin, x);
  const double doubt = std::sqrt(weights_->exposure_variance(channel, j + 1, std::max(threshold, 0.0)) + t * t * variance);
  return static_cast<float>((threshold + margin * certain_sigmas * doubt) / t);
}

/// Adds the clipped exposures near the threshold: maximises the censored Gaussian likelihood by Newton's method (it is log-concave). In:
/// mean and variance from the values that are not clipped.
void MergeFinish::add_lower_bounds(std::size_t channel, std::uint64_t usable, const Pixel& pixel, Estimate& e) const {
  struct Bound {
    double time, threshold, sigma;
  };
  std::array<Bound, 8> bounds;  // exposures whose clipping is in doubt: few, since times differ
  std::size_t n = 0;
  const auto usual = ascending_ && (usable & (usable + 1)) == 0 ? static_cast<std::size_t>(std::popcount(usable)) : 0;  // those before are usable
  for (std::size_t k = usual; k < by_time_.size(); ++k) {
    const std::size_t j = by_time_[k];
    if (usable >> j & 1) continue;
    const double t = times_[j], z = e.value * t, threshold = this->threshold(channel, j) - pixel.dark_rate * t - pixel.offset;
    const double sigma2 = weights_->exposure_variance(channel, j, std::max(z, 0.0));
    const double doubt = std::sqrt(sigma2 + t * t * e.variance);
    if (z - threshold > certain_sigmas * doubt || n == bounds.size()) break;  // certainly clipped, and so are all longer ones
    if (threshold - z > bound_sigmas * doubt) continue;
    bounds[n++] = {t, threshold, std::sqrt(sigma2)};
  }
  const double precision = 1 / e.variance;
  double x = e.value, information = precision;
  for (int iteration = 0; n > 0 && iteration < 20; ++iteration) {
    double score = precision * (e.value - x);
    information = precision;
    for (std::size_t k = 0; k < n; ++k) {
      const double a = (bounds[k].threshold - x * bounds[k].time) / bounds[k].sigma, lambda = mills_ratio(a);
      const double t = bounds[k].time / bounds[k].sigma;
      score += lambda * t;
      information += lambda * (lambda - a) * t * t;
    }
    const double step = score / information;
    x += step;
    if (step * step * information < 1e-4) break;  // a hundredth of a sigma: the next step would be of its square
  }
  e.value = x;
  e.variance = 1 / information;
}

/// Clipped in every exposure.
MergeFinish::Estimate MergeFinish::lower_bound(std::size_t channel, const Pixel& pixel) const {
  const std::size_t j = by_time_.front();
  const double t = times_[j], bound = std::max(threshold(channel, j) - pixel.dark_rate * t - pixel.offset, 0.0);
  return {bound / t, weights_->exposure_variance(channel, j, bound) / (t * t), PixelFlag::clipped};
}

MergeFinish::Estimate MergeFinish::estimate(std::size_t channel, std::uint64_t usable, const std::array<float, n_sums>& s,
                                            const Pixel& pixel) const {
  if (usable == 0) return lower_bound(channel, pixel);
  const MergeWeightTable table = weights_->table();
  const auto count = static_cast<std::int32_t>(std::popcount(usable));
  const bool first_ones = (usable & (usable + 1)) == 0;
  const float inverse = first_ones ? inverse_prediction_time_[static_cast<std::size_t>(count - 1)]
                                   : static_cast<float>(1 / weights_->prediction_time(usable));
  const float x_near = s[n_sums - 1] * inverse - static_cast<float>(pixel.dark_rate);
  const std::int32_t bin = table.bin_of(x_near);
  const MergeWeight w = first_ones ? table.at(static_cast<std::int32_t>(channel), count, bin) : weights_->of_set(channel, usable, x_near);
  Estimate e;
  e.value = static_cast<double>(w.a[0]) * s[0] + static_cast<double>(w.a[1]) * s[1] + static_cast<double>(w.a[2]) * s[2] -
            pixel.dark_rate - w.offset_gain * pixel.offset;
  e.variance = table.variance(w, bin, static_cast<float>(e.value)) + w.variance_dark * (pixel.dark_rate - dark_rate_);
  if (!maps_.offset.empty()) e.variance += std::pow(w.offset_gain * maps_.offset_sigma, 2);
  if (static_cast<std::size_t>(count) < times_.size()) add_lower_bounds(channel, usable, pixel, e);
  e.flag = e.value * std::abs(e.value) < e.variance ? PixelFlag::dark : PixelFlag::valid;
  return e;
}

/// Flat field and bad values.
void MergeFinish::correct(std::size_t index, Estimate& e) const {
  if (!maps_.dark_rate.empty()) e.variance += maps_.dark_rate_sigma * maps_.dark_rate_sigma;
  if (!maps_.flat.empty()) {
    const double flat = maps_.flat[index] > 0 ? maps_.flat[index] : 1.0;  // 0 only where the value is bad
    e.value /= flat;
    e.variance = e.variance / (flat * flat) + std::pow(maps_.flat_sigma * e.value, 2);
  }
  if (!maps_.bad.empty() && maps_.bad[index]) e.flag = PixelFlag::invalid;
}

void MergeFinish::store_one(const ConstSums& sums, std::size_t i, std::size_t first, std::size_t channel, RadianceImage& image) const {
  Pixel pixel{0, dark_rate_};
  if (!maps_.offset.empty()) pixel.offset = maps_.offset[first + i];
  if (!maps_.dark_rate.empty()) pixel.dark_rate = maps_.dark_rate[first + i];
  const std::uint64_t high = sums.usable_high ? sums.usable_high[i] : 0;
  Estimate e = estimate(channel, high << 32 | sums.usable[i], {sums.sums[0][i], sums.sums[1][i], sums.sums[2][i]}, pixel);
  if (!maps_.empty()) correct(first + i, e);
  image.radiance[first + i] = static_cast<float>(e.value);
  image.variance[first + i] = static_cast<float>(e.variance);
  image.flags[first + i] = e.flag;
}

void MergeFinish::store(const ConstSums& sums, std::size_t first, std::size_t n, const std::array<std::size_t, 3>& channels,
                        std::size_t period, RadianceImage& image) const {
  if (!maps_.empty() || !ascending_) {
    for (std::size_t i = 0; i < n; ++i) store_one(sums, i, first, weights_->n_channels() > 1 ? channels[i % period] : 0, image);
    return;
  }
  static_assert(sizeof(PixelFlag) == 1 && static_cast<int>(PixelFlag::valid) == 0 && static_cast<int>(PixelFlag::dark) == 2);
  FinishTables tables{weights_->table(), inverse_prediction_time_.data(), static_cast<float>(dark_rate_), period, {}};
  for (std::size_t k = 0; k < period; ++k) tables.channels[k] = weights_->n_channels() > 1 ? static_cast<std::int32_t>(channels[k]) : 0;
  std::vector<std::uint16_t> left_out(n);
  const std::size_t n_left = finish_values(sums, n, tables, &image.radiance[first], &image.variance[first],
                                           reinterpret_cast<std::uint8_t*>(&image.flags[first]), left_out.data());
  for (std::size_t k = 0; k < n_left; ++k)
    store_one(sums, left_out[k], first, static_cast<std::size_t>(tables.channels[left_out[k] % period]), image);
}

}  // namespace lacquer::calib
