#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "libcalib/photon_transfer.h"

/// Sums over single frames and pairs of frames for photon_transfer(). Internal to libcalib. Rows are summed in order whatever the number
/// of threads, so that results are the same bytes.
namespace lacquer::calib {

/// What all frames must have in common, and which channel each value belongs to.
struct FrameShape {
  int width = 0, height = 0, bits = 0;
  acquire::PixelLayout layout = acquire::PixelLayout::mono;
  double gain_db = 0;

  std::size_t row_size() const;  ///< values
  std::size_t n_values() const { return row_size() * static_cast<std::size_t>(height); }
  int n_channels() const { return acquire::n_channels(layout); }
  /// Channel of each value of an even (0) or odd (1) row.
  std::vector<std::uint8_t> channels_of_row(int parity) const;
  /// Distance in a row to the next value of the same channel.
  std::size_t neighbour() const;
};

/// Channel of value number i of a frame.
class ChannelMap {
 public:
  explicit ChannelMap(const FrameShape& shape)
      : row_size_(shape.row_size()), rows_{shape.channels_of_row(0), shape.channels_of_row(1)} {}
  std::size_t operator()(std::size_t i) const { return rows_[i / row_size_ & 1][i % row_size_]; }

 private:
  std::size_t row_size_;
  std::array<std::vector<std::uint8_t>, 2> rows_;
};

/// Reads frames and compares each with the first. Throws Error{input} naming the frame that differs.
class CheckedReader {
 public:
  acquire::RawFrame read(const FrameSeries& series, std::size_t index);
  const FrameShape& shape() const { return *shape_; }

 private:
  std::optional<FrameShape> shape_;
  std::string first_name_;
};

/// Per channel: linearised DN of each raw value, and the variance that rounding to a whole raw value gives it.
struct Linearisation {
  std::vector<std::vector<float>> exposure;
  std::vector<std::vector<float>> quantisation;
};
Linearisation make_linearisation(const std::optional<Response>& response, const FrameShape& shape);

/// What a value shows without light, linearised DN: base + rate * t, of its channel, or of itself where there are maps.
struct DarkSignal {
  std::array<double, 3> base{}, rate{};
  const std::vector<double>* base_map = nullptr;  ///< instead of `base`
  const std::vector<double>* rate_map = nullptr;  ///< instead of `rate`
  double at(std::size_t i, std::size_t channel, double t) const {
    return (base_map ? (*base_map)[i] : base[channel]) + (rate_map ? (*rate_map)[i] : rate[channel]) * t;
  }
};

using BadMask = std::vector<std::uint8_t>;  ///< 1: left out

/// Mean over the values of a channel that are not bad.
struct ChannelMean {
  double n = 0, mean = 0;
  double zero_share = 0;  ///< of raw values that are 0
};
std::vector<ChannelMean> channel_means(const acquire::RawFrame& frame, const FrameShape& shape, const Linearisation& linear,
                                       const BadMask& bad);

/// Two frames of one exposure, one channel. With signals a, b above dark and ratio r of their means (1 for darks):
/// variance = mean((a - r b)^2) / (1 + r^2), and mean and mean_square weigh a and b alike (a once, b r^2 times over 1 + r^2), so that
/// variance = c + k mean + q mean_square holds exactly where it holds for each frame.
struct PairStatistics {
  double n = 0;
  double ratio = 1;
  double mean = 0, mean_square = 0;
  double variance = 0;      ///< quantisation not removed
  double quantisation = 0;  ///< mean variance of rounding
  double correlation = 0;   ///< of the difference between neighbours of the channel
  double raw_mean = 0, raw_sigma = 0;  ///< of the raw values, over frame and time
  double clipped_share = 0;            ///< of raw values >= saturation
};

struct PairOptions {
  bool flat = false;      ///< the lamp may have changed between the two; else only the black level may
  int saturation = 0;
};
std::vector<PairStatistics> pair_statistics(const acquire::RawFrame& a, const acquire::RawFrame& b, const FrameShape& shape,
                                            const Linearisation& linear, const DarkSignal& dark, const BadMask& bad,
                                            const PairOptions& options);

}  // namespace lacquer::calib
