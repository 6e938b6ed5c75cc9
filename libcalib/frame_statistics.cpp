#include "libcalib/frame_statistics.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

#include "libbrdf/error.h"

namespace lacquer::calib {

using acquire::RawFrame;

namespace {

/// Calls work(row, channels of the row) for all rows in parallel.
template <typename Work>
void for_each_row(const FrameShape& shape, const Work& work) {
  const std::array<std::vector<std::uint8_t>, 2> channels{shape.channels_of_row(0), shape.channels_of_row(1)};
  tbb::parallel_for(0, shape.height, [&](int y) { work(static_cast<std::size_t>(y), channels[static_cast<std::size_t>(y & 1)]); });
}

/// Sums of one row; added up row by row.
struct LevelSums {
  double n = 0, a = 0, b = 0, product = 0, quantisation = 0, raw = 0, raw_square = 0, clipped = 0;
  void add(const LevelSums& o) {
    n += o.n, a += o.a, b += o.b, product += o.product, quantisation += o.quantisation;
    raw += o.raw, raw_square += o.raw_square, clipped += o.clipped;
  }
};

struct DifferenceSums {
  double sum = 0, square = 0, lagged = 0;
  void add(const DifferenceSums& o) { sum += o.sum, square += o.square, lagged += o.lagged; }
};

template <typename Sums>
std::array<Sums, 3> total(const std::vector<std::array<Sums, 3>>& rows) {
  std::array<Sums, 3> sums{};
  for (const auto& row : rows)
    for (std::size_t c = 0; c < 3; ++c) sums[c].add(row[c]);
  return sums;
}

/// The two frames and how their values become signals.
struct Pair {
  const RawFrame& a;
  const RawFrame& b;
  const FrameShape& shape;
  const Linearisation& linear;
  const DarkSignal& dark;
  const BadMask& bad;
  bool good(std::size_t i) const { return bad.empty() || bad[i] == 0; }
  double signal(const RawFrame& frame, std::size_t i, std::size_t channel) const {
    return static_cast<double>(linear.exposure[channel][frame.data[i]]) - dark.at(i, channel, frame.actual.exposure_s);
  }
};

std::array<LevelSums, 3> level_sums(const Pair& p, int saturation) {
  std::vector<std::array<LevelSums, 3>> rows(static_cast<std::size_t>(p.shape.height));
  for_each_row(p.shape, [&](std::size_t y, const std::vector<std::uint8_t>& channels) {
    std::array<LevelSums, 3> sums{};
    for (std::size_t x = 0; x < channels.size(); ++x) {
      const std::size_t i = y * channels.size() + x, c = channels[x];
      if (!p.good(i)) continue;
      const double a = p.signal(p.a, i, c), b = p.signal(p.b, i, c), raw_a = p.a.data[i], raw_b = p.b.data[i];
      LevelSums& s = sums[c];
      s.n += 1;
      s.a += a;
      s.b += b;
      s.product += a * b;
      s.quantisation += static_cast<double>(p.linear.quantisation[c][p.a.data[i]]) + static_cast<double>(p.linear.quantisation[c][p.b.data[i]]);
      s.raw += raw_a + raw_b;
      s.raw_square += raw_a * raw_a + raw_b * raw_b;
      s.clipped += (p.a.data[i] >= saturation) + (p.b.data[i] >= saturation);
    }
    rows[y] = sums;
  });
  return total(rows);
}

/// Of a - ratio b - shift.
std::array<DifferenceSums, 3> difference_sums(const Pair& p, const std::array<double, 3>& ratio, const std::array<double, 3>& shift) {
  const std::size_t lag = p.shape.neighbour();
  std::vector<std::array<DifferenceSums, 3>> rows(static_cast<std::size_t>(p.shape.height));
  for_each_row(p.shape, [&](std::size_t y, const std::vector<std::uint8_t>& channels) {
    std::array<DifferenceSums, 3> sums{};
    std::array<double, 4> recent{};  // differences of the last `lag` values, 0 where bad
    for (std::size_t x = 0; x < channels.size(); ++x) {
      const std::size_t i = y * channels.size() + x, c = channels[x];
      double d = 0;
      if (p.good(i)) d = p.signal(p.a, i, c) - ratio[c] * p.signal(p.b, i, c) - shift[c];
      sums[c].sum += d;
      sums[c].square += d * d;
      sums[c].lagged += d * recent[x % lag];
      recent[x % lag] = d;
    }
    rows[y] = sums;
  });
  return total(rows);
}

}  // namespace

std::size_t FrameShape::row_size() const {
  return static_cast<std::size_t>(width) * static_cast<std::size_t>(acquire::values_per_pixel(layout));
}

std::vector<std::uint8_t> FrameShape::channels_of_row(int parity) const {
  std::vector<std::uint8_t> channels(row_size());
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(layout));
  for (std::size_t i = 0; i < channels.size(); ++i)
    channels[i] = static_cast<std::uint8_t>(
        acquire::channel_of(layout, static_cast<int>(i / per_pixel), parity, static_cast<int>(i % per_pixel)));
  return channels;
}

std::size_t FrameShape::neighbour() const {
  if (layout == acquire::PixelLayout::mono) return 1;
  return layout == acquire::PixelLayout::rgb ? 3 : 2;
}

RawFrame CheckedReader::read(const FrameSeries& series, std::size_t index) {
  const std::string& name = series.items[index].name;
  RawFrame frame = series.read(index);
  frame.actual.exposure_s = series.items[index].exposure_s;
  const FrameShape shape{frame.width, frame.height, frame.bits, frame.layout, frame.actual.gain_db};
  if (frame.bits < 8 || frame.bits > 16 || frame.width < 1 || frame.height < 1 || frame.data.size() != shape.n_values())
    throw Error(ErrorCode::input, fmt::format("{}: expected {} values of 8 to 16 bits for {} x {} {}, got {} of {} bits", name,
                                              shape.n_values(), frame.width, frame.height, acquire::name_of(frame.layout),
                                              frame.data.size(), frame.bits));
  if (!shape_) {
    shape_ = shape;
    first_name_ = name;
  }
  const FrameShape& first = *shape_;
  if (frame.width != first.width || frame.height != first.height || frame.layout != first.layout || frame.bits != first.bits)
    throw Error(ErrorCode::input, fmt::format("{}: is {} x {} {} of {} bits, expected {} x {} {} of {} bits as {}", name, frame.width,
                                              frame.height, acquire::name_of(frame.layout), frame.bits, first.width, first.height,
                                              acquire::name_of(first.layout), first.bits, first_name_));
  if (frame.actual.gain_db != first.gain_db)
    throw Error(ErrorCode::input, fmt::format("{}: gain is {} dB, expected {} dB as {}; measure each gain by itself", name,
                                              frame.actual.gain_db, first.gain_db, first_name_));
  const auto beyond = std::find_if(frame.data.begin(), frame.data.end(), [&](std::uint16_t v) { return v >> frame.bits != 0; });
  if (beyond != frame.data.end())
    throw Error(ErrorCode::input, fmt::format("{}: value {} needs more than {} bits", name, *beyond, frame.bits));
  return frame;
}

Linearisation make_linearisation(const std::optional<Response>& response, const FrameShape& shape) {
  const std::size_t n_levels = std::size_t{1} << shape.bits, n_channels = static_cast<std::size_t>(shape.n_channels());
  const bool curved = response && !response->linear;
  if (response && (response->bits != shape.bits || response->curves.size() != n_channels))
    throw Error(ErrorCode::input, fmt::format("response: expected {} bits and {} channels as the frames have, got {} and {}", shape.bits,
                                              n_channels, response->bits, response->curves.size()));
  Linearisation linear;
  for (std::size_t c = 0; c < n_channels; ++c) {
    std::vector<float> exposure(n_levels), quantisation(n_levels, 1.0f / 12);
    for (std::size_t v = 0; v < n_levels; ++v) exposure[v] = static_cast<float>(v);
    if (curved) {
      const std::vector<double>& curve = response->curves[c].exposure;
      if (curve.size() != n_levels)
        throw Error(ErrorCode::input, fmt::format("response: curve: expected {} values, got {}", n_levels, curve.size()));
      for (std::size_t v = 0; v < n_levels; ++v) {
        const std::size_t low = v > 0 ? v - 1 : v, high = std::min(v + 1, n_levels - 1);
        const double slope = (curve[high] - curve[low]) / static_cast<double>(high - low);
        exposure[v] = static_cast<float>(curve[v]);
        quantisation[v] = static_cast<float>(slope * slope / 12);
      }
    }
    linear.exposure.push_back(std::move(exposure));
    linear.quantisation.push_back(std::move(quantisation));
  }
  return linear;
}

std::vector<ChannelMean> channel_means(const RawFrame& frame, const FrameShape& shape, const Linearisation& linear, const BadMask& bad) {
  struct Sums {
    double n = 0, sum = 0, zeros = 0;
    void add(const Sums& o) { n += o.n, sum += o.sum, zeros += o.zeros; }
  };
  std::vector<std::array<Sums, 3>> rows(static_cast<std::size_t>(shape.height));
  for_each_row(shape, [&](std::size_t y, const std::vector<std::uint8_t>& channels) {
    std::array<Sums, 3> sums{};
    for (std::size_t x = 0; x < channels.size(); ++x) {
      const std::size_t i = y * channels.size() + x;
      if (!bad.empty() && bad[i]) continue;
      Sums& s = sums[channels[x]];
      s.n += 1;
      s.sum += static_cast<double>(linear.exposure[channels[x]][frame.data[i]]);
      s.zeros += frame.data[i] == 0;
    }
    rows[y] = sums;
  });
  const auto sums = total(rows);
  std::vector<ChannelMean> means;
  for (std::size_t c = 0; c < static_cast<std::size_t>(shape.n_channels()); ++c)
    means.push_back({sums[c].n, sums[c].n > 0 ? sums[c].sum / sums[c].n : 0, sums[c].n > 0 ? sums[c].zeros / sums[c].n : 0});
  return means;
}

std::vector<PairStatistics> pair_statistics(const RawFrame& a, const RawFrame& b, const FrameShape& shape, const Linearisation& linear,
                                            const DarkSignal& dark, const BadMask& bad, const PairOptions& options) {
  const Pair pair{a, b, shape, linear, dark, bad};
  const auto levels = level_sums(pair, options.saturation);
  std::array<double, 3> ratio{1, 1, 1}, shift{};
  for (std::size_t c = 0; c < 3; ++c) {
    const LevelSums& s = levels[c];
    if (options.flat && s.a > 0 && s.b > 0) ratio[c] = s.a / s.b;
    if (s.n > 0) shift[c] = (s.a - ratio[c] * s.b) / s.n;  // 0 up to rounding where the ratio is free
  }
  const auto differences = difference_sums(pair, ratio, shift);

  std::vector<PairStatistics> statistics;
  for (std::size_t c = 0; c < static_cast<std::size_t>(shape.n_channels()); ++c) {
    const LevelSums& s = levels[c];
    PairStatistics p;
    p.n = s.n;
    if (s.n >= 2) {
      const double r = ratio[c], weight = 1 + r * r, mean_raw = s.raw / (2 * s.n);
      p.ratio = r;
      p.mean = (s.a + r * r * s.b) / s.n / weight;
      p.mean_square = 2 * r * s.product / s.n / weight;
      p.variance = differences[c].square / (s.n - 1) / weight;
      p.quantisation = s.quantisation / (2 * s.n);
      p.correlation = differences[c].square > 0 ? differences[c].lagged / differences[c].square : 0;
      p.raw_mean = mean_raw;
      p.raw_sigma = std::sqrt(std::max(s.raw_square / (2 * s.n) - mean_raw * mean_raw, 0.0));
      p.clipped_share = s.clipped / (2 * s.n);
    }
    statistics.push_back(p);
  }
  return statistics;
}

}  // namespace lacquer::calib
