#include "libcalib/uniformity.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numeric>

namespace lacquer::calib {

using acquire::RawFrame;

namespace {

/// Calls work(index, channel) for each value, rows in parallel; every value is written by one call only.
template <typename Work>
void for_each_value(const FrameShape& shape, const Work& work) {
  const std::array<std::vector<std::uint8_t>, 2> channels{shape.channels_of_row(0), shape.channels_of_row(1)};
  tbb::parallel_for(0, shape.height, [&](int y) {
    const std::vector<std::uint8_t>& row = channels[static_cast<std::size_t>(y & 1)];
    for (std::size_t x = 0; x < row.size(); ++x) work(static_cast<std::size_t>(y) * row.size() + x, std::size_t{row[x]});
  });
}

double linearised(const Linearisation& linear, const RawFrame& frame, std::size_t i, std::size_t channel) {
  return static_cast<double>(linear.exposure[channel][frame.data[i]]);
}

}  // namespace

DarkSums::DarkSums(const std::vector<double>& exposures_s, std::size_t n_values)
    : times_(exposures_s), base_(n_values), rate_(n_values), pair_sum_(n_values) {
  const double n = static_cast<double>(times_.size());
  mean_time_ = std::accumulate(times_.begin(), times_.end(), 0.0) / n;
  const auto [low, high] = std::minmax_element(times_.begin(), times_.end());
  if (*low == *high) return;  // one time: rounding of the mean must not look like a spread
  for (const double t : times_) spread_ += (t - mean_time_) * (t - mean_time_);
}

double DarkSums::rate_weight(double t) const { return has_rate() ? (t - mean_time_) / spread_ : 0; }

double DarkSums::base_weight(double t) const { return 1 / static_cast<double>(times_.size()) - mean_time_ * rate_weight(t); }

void DarkSums::add(const RawFrame& frame, const FrameShape& shape, const Linearisation& linear) {
  const double base = base_weight(frame.actual.exposure_s), rate = rate_weight(frame.actual.exposure_s);
  for_each_value(shape, [&](std::size_t i, std::size_t channel) {
    const double z = linearised(linear, frame, i, channel);
    base_[i] += base * z;
    rate_[i] += rate * z;
  });
}

void DarkSums::add_pair(const RawFrame& a, const RawFrame& b, const FrameShape& shape, const Linearisation& linear,
                        const std::vector<double>& shift) {
  for_each_value(shape, [&](std::size_t i, std::size_t channel) {
    const double d = linearised(linear, a, i, channel) - linearised(linear, b, i, channel) - shift[channel];
    pair_sum_[i] += static_cast<float>(d * d / 2);
  });
}

DarkSums::Errors DarkSums::errors(double constant, double per_second) const {
  Errors e;
  for (const double t : times_) {
    const double variance = constant + per_second * t, base = base_weight(t), rate = rate_weight(t);
    e.base += base * base * variance;
    e.rate += rate * rate * variance;
    e.covariance += base * rate * variance;
  }
  return e;
}

void FlatSums::add_pair(const RawFrame& a, const RawFrame& b, const FrameShape& shape, const Linearisation& linear,
                        const DarkSignal& dark, const std::vector<bool>& use) {
  for_each_value(shape, [&](std::size_t i, std::size_t channel) {
    if (!use[channel]) return;
    signal_[i] += linearised(linear, a, i, channel) - dark.at(i, channel, a.actual.exposure_s);
    signal_[i] += linearised(linear, b, i, channel) - dark.at(i, channel, b.actual.exposure_s);
    if (a.data[i] != b.data[i]) changed_[i] = 1;
  });
}

RobustSpread robust_spread(const std::vector<double>& values, const BadMask& bad) {
  std::vector<double> good;
  good.reserve(values.size());
  for (std::size_t i = 0; i < values.size(); ++i)
    if (bad.empty() || !bad[i]) good.push_back(values[i]);
  if (good.empty()) return {};
  const auto median = [&good] {
    const auto middle = good.begin() + static_cast<std::ptrdiff_t>(good.size() / 2);
    std::nth_element(good.begin(), middle, good.end());
    return *middle;
  };
  RobustSpread spread;
  spread.median = median();
  for (double& v : good) v = std::abs(v - spread.median);
  spread.sigma = 1.4826 * median();  // of normal numbers
  return spread;
}

std::vector<Measured> spread_beyond_noise(const std::vector<double>& values, const FrameShape& shape, const BadMask& bad,
                                          const std::vector<double>& noise, int lost) {
  struct Sums {
    double n = 0, mean = 0, square = 0;
    void add(double v) {  // Welford 1962
      const double d = v - mean;
      mean += d / ++n;
      square += d * (v - mean);
    }
  };
  const std::size_t n_channels = static_cast<std::size_t>(shape.n_channels());
  std::vector<Sums> sums(n_channels);
  const ChannelMap channel_of(shape);
  for (std::size_t i = 0; i < values.size(); ++i)
    if (bad.empty() || !bad[i]) sums[channel_of(i)].add(values[i]);
  const auto measured = [](double square, double dof, double noise_variance) {
    if (!(dof > 0)) return Measured{};
    const double variance = square / dof, net = std::max(variance - noise_variance, 0.0), sigma = variance * std::sqrt(2 / dof);
    const double rms = std::sqrt(net);
    return Measured{rms, net > sigma ? sigma / (2 * rms) : std::sqrt(net + sigma) - rms};
  };
  std::vector<Measured> result;
  double square = 0, dof = 0, noise_sum = 0;
  for (std::size_t c = 0; c < n_channels; ++c) {
    const double own = sums[c].n - 1 - lost;
    result.push_back(measured(sums[c].square, own, noise[c]));
    if (!(own > 0)) continue;
    square += sums[c].square;
    dof += own;
    noise_sum += own * noise[c];
  }
  result.push_back(measured(square, dof, dof > 0 ? noise_sum / dof : 0));
  return result;
}

double largest_by_chance(double dof, std::size_t n_values) {
  // Upper normal quantile of p: two terms of its asymptotic series, within 1 % for p < 1e-3.
  const double twice_log = 2 * std::log(std::max(static_cast<double>(n_values), 10.0) / 0.01);
  const double z = std::sqrt(twice_log - std::log(2 * 3.14159265358979323846 * twice_log));
  const double spread = 2 / (9 * dof), root = 1 - spread + z * std::sqrt(spread);
  return root * root * root;
}

}  // namespace lacquer::calib
