#include "libcalib/bracket_samples.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <numeric>

#include "libbrdf/error.h"

namespace lacquer::calib {

namespace {

using acquire::RawFrame;

/// Candidates looked at per pixel that is kept: enough to find the rare bright ones.
constexpr int candidates_per_pixel = 8;
constexpr std::size_t n_brightness_bins = 64;  ///< four per octave over sixteen octaves

struct Candidate {
  std::uint32_t bracket;
  std::size_t index;  ///< into RawFrame::data
};

[[noreturn]] void fail(std::size_t frame, std::size_t n_frames, const std::string& what) {
  throw Error(ErrorCode::input, fmt::format("frame {} of {}: {}", frame + 1, n_frames, what));
}

/// Which of the candidates to keep so that every brightness bin gives its share: bins that hold less than the fair share give all.
std::vector<Candidate> spread_over_brightness(std::array<std::vector<Candidate>, n_brightness_bins>& bins, std::size_t wanted) {
  std::array<std::size_t, n_brightness_bins> order{};
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) { return bins[a].size() < bins[b].size(); });
  std::vector<Candidate> kept;
  for (std::size_t k = 0; k < order.size(); ++k) {
    const auto& bin = bins[order[k]];
    const std::size_t share = std::min(bin.size(), (wanted - kept.size()) / (order.size() - k));
    for (std::size_t i = 0; i < share; ++i) kept.push_back(bin[i * bin.size() / share]);
  }
  return kept;
}

std::vector<Candidate> choose_pixels(std::span<const std::vector<RawFrame>> brackets, int channel, const SamplingOptions& options) {
  std::array<std::vector<Candidate>, n_brightness_bins> bins;
  const auto wanted = static_cast<std::size_t>(options.max_pixels);
  for (std::size_t b = 0; b < brackets.size(); ++b) {
    const RawFrame& f = brackets[b].front();
    const int border = options.ignore_border_px, per_pixel = acquire::values_per_pixel(f.layout);
    const std::size_t values = f.data.size(), share = wanted * candidates_per_pixel / brackets.size() + 1;
    // An odd stride walks through all columns and both mosaic phases.
    const std::size_t stride = (values / static_cast<std::size_t>(acquire::n_channels(f.layout)) / share) | 1;
    std::size_t seen = 0;
    for (int y = border; y < f.height - border; ++y)
      for (int x = border; x < f.width - border; ++x)
        for (int k = 0; k < per_pixel; ++k) {
          if (acquire::channel_of(f.layout, x, y, k) != channel || seen++ % stride != 0) continue;
          const std::size_t index = (static_cast<std::size_t>(y) * static_cast<std::size_t>(f.width) + static_cast<std::size_t>(x)) *
                                        static_cast<std::size_t>(per_pixel) +
                                    static_cast<std::size_t>(k);
          double sum = 1;
          for (const RawFrame& frame : brackets[b]) sum += frame.data[index];
          const auto bin = static_cast<std::size_t>(4 * std::log2(sum / static_cast<double>(brackets[b].size()) + 1));
          bins[std::min(bin, n_brightness_bins - 1)].push_back({static_cast<std::uint32_t>(b), index});
        }
  }
  return spread_over_brightness(bins, wanted);
}

/// Frames of each bracket in the order of their exposure, with the index of that exposure in BracketSamples::times.
struct OrderedFrame {
  const RawFrame* frame;
  std::uint16_t time;
};

std::vector<std::vector<OrderedFrame>> order_frames(std::span<const std::vector<RawFrame>> brackets, BracketSamples& samples) {
  std::vector<double> listed;
  for (const auto& bracket : brackets)
    for (const RawFrame& f : bracket) listed.push_back(f.actual.exposure_s);
  std::vector<std::size_t> order(listed.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) { return listed[a] < listed[b]; });
  samples.exposure_of_frame.resize(listed.size());
  const bool one_per_frame = listed.size() <= max_exposures;
  for (const std::size_t f : order) {
    if (one_per_frame || samples.times.empty() || samples.times.back() != listed[f]) samples.times.push_back(listed[f]);
    samples.exposure_of_frame[f] = samples.times.size() - 1;
  }
  if (samples.times.size() > max_exposures)
    throw Error(ErrorCode::input, fmt::format("response: expected at most {} different exposure times, got {}", max_exposures, samples.times.size()));
  std::vector<std::vector<OrderedFrame>> ordered;
  for (std::size_t b = 0, f = 0; b < brackets.size(); ++b) {
    auto& frames = ordered.emplace_back();
    for (const RawFrame& frame : brackets[b]) frames.push_back({&frame, static_cast<std::uint16_t>(samples.exposure_of_frame[f++])});
    std::sort(frames.begin(), frames.end(), [](const auto& a, const auto& b) { return a.time < b.time; });
  }
  return ordered;
}

void check_brackets(std::span<const std::vector<RawFrame>> brackets) {
  if (brackets.empty()) throw Error(ErrorCode::input, "response: expected at least one bracket of frames, got none");
  bool times_differ = false;
  for (const auto& bracket : brackets) {
    check_bracket(bracket);
    const RawFrame& f = bracket.front();
    if (f.bits != brackets.front().front().bits || f.layout != brackets.front().front().layout)
      throw Error(ErrorCode::input, "response: expected the same bits and layout in all brackets");
    for (const RawFrame& other : bracket) times_differ |= other.actual.exposure_s != f.actual.exposure_s;
  }
  if (!times_differ)
    throw Error(ErrorCode::input, "response: expected frames with different exposure times, all are alike; a response cannot be found");
}

}  // namespace

void check_frame_format(const RawFrame& f, const RawFrame& first, std::size_t i, std::size_t n) {
  if (f.bits < 8 || f.bits > 16) fail(i, n, fmt::format("bits: expected 8 to 16, got {}", f.bits));
  if (f.width < 1 || f.height < 1) fail(i, n, fmt::format("size: expected at least 1 x 1, got {} x {}", f.width, f.height));
  if (f.width != first.width || f.height != first.height)
    fail(i, n, fmt::format("size: expected {} x {} as in frame 1, got {} x {}", first.width, first.height, f.width, f.height));
  if (f.layout != first.layout)
    fail(i, n, fmt::format("layout: expected {} as in frame 1, got {}", acquire::name_of(first.layout), acquire::name_of(f.layout)));
  if (f.bits != first.bits) fail(i, n, fmt::format("bits: expected {} as in frame 1, got {}", first.bits, f.bits));
  if (f.actual.gain_db != first.actual.gain_db)
    fail(i, n, fmt::format("gain: expected {} dB as in frame 1, got {} dB; noise and response hold for one gain", first.actual.gain_db,
                           f.actual.gain_db));
  if (!(f.actual.exposure_s >= 1e-9 && f.actual.exposure_s <= 1e6))
    fail(i, n, fmt::format("exposure: expected a number of seconds in [1e-9, 1e6], got {}", f.actual.exposure_s));
  const std::size_t expected = static_cast<std::size_t>(f.width) * static_cast<std::size_t>(f.height) *
                               static_cast<std::size_t>(acquire::values_per_pixel(f.layout));
  if (f.data.size() != expected) fail(i, n, fmt::format("data: expected {} values, got {}", expected, f.data.size()));
}

void check_frame_values(const RawFrame& f, std::size_t i, std::size_t n) {
  const auto limit = static_cast<std::uint32_t>(1u << f.bits);
  // A plain reduction instead of find_if: it vectorises, and bad frames are rare.
  std::uint32_t largest = 0;
  for (const std::uint16_t v : f.data) largest = std::max<std::uint32_t>(largest, v);
  if (largest >= limit) fail(i, n, fmt::format("value {}: expected less than 2^{} = {}", largest, f.bits, limit));
}

void check_bracket_format(std::span<const RawFrame> frames) {
  if (frames.empty()) throw Error(ErrorCode::input, "bracket: expected at least one frame, got none");
  for (std::size_t i = 0; i < frames.size(); ++i) check_frame_format(frames[i], frames.front(), i, frames.size());
}

void check_bracket(std::span<const RawFrame> frames) {
  check_bracket_format(frames);
  for (std::size_t i = 0; i < frames.size(); ++i) check_frame_values(frames[i], i, frames.size());
}

namespace {

constexpr int min_different_values = 32;

/// `seen[v]`: value v occurs.
int unused_bits(const std::vector<char>& seen, int bits) {
  unsigned all = 0;
  int different = 0;
  for (std::size_t v = 1; v < seen.size(); ++v)
    if (seen[v]) {
      all |= static_cast<unsigned>(v);
      ++different;
    }
  if (different < min_different_values) return 0;
  const int unused = std::countr_zero(all);
  return bits - unused >= 8 ? unused : 0;
}

}  // namespace

int left_aligned_bits(std::span<const RawFrame> frames) {
  if (frames.empty()) return 0;
  std::vector<char> seen(std::size_t{1} << 16);
  for (const RawFrame& f : frames)
    for (const std::uint16_t v : f.data) {
      seen[v] = 1;
      if (v & 1) return 0;  // the usual case ends early
    }
  return unused_bits(seen, frames.front().bits);
}

int right_align(std::vector<RawFrame>& frames) {
  const int shift = left_aligned_bits(frames);
  if (shift == 0) return 0;
  for (RawFrame& f : frames) {
    for (std::uint16_t& v : f.data) v = static_cast<std::uint16_t>(v >> shift);
    f.bits -= shift;
  }
  return shift;
}

std::size_t BracketSamples::step_to(std::size_t n_pixels) const {
  std::size_t most = 1;
  for (const SampledPixels& pixels : channels) most = std::max(most, pixels.n_pixels());
  return std::max<std::size_t>(1, most / n_pixels);
}

BracketSamples BracketSamples::thinned(std::size_t step) const {
  BracketSamples copy{bits, times, exposure_of_frame, {}, unused_low_bits};
  for (const SampledPixels& pixels : channels) {
    SampledPixels& kept = copy.channels.emplace_back();
    for (std::size_t i = 0; i < pixels.n_pixels(); i += step) {
      const auto begin = pixels.observations.begin();
      kept.observations.insert(kept.observations.end(), begin + static_cast<std::ptrdiff_t>(pixels.first[i]),
                               begin + static_cast<std::ptrdiff_t>(pixels.first[i + 1]));
      kept.first.push_back(kept.observations.size());
    }
  }
  return copy;
}

BracketSamples BracketSamples::with_times(const std::vector<double>& log_time_corrections) const {
  BracketSamples copy = *this;
  for (std::size_t j = 0; j < times.size(); ++j) copy.times[j] *= std::exp(log_time_corrections[j]);
  return copy;
}

BracketSamples sample_brackets(std::span<const std::vector<RawFrame>> brackets, const SamplingOptions& options) {
  check_brackets(brackets);
  BracketSamples samples;
  samples.bits = brackets.front().front().bits;
  std::vector<char> seen(std::size_t{1} << 16);
  const auto ordered = order_frames(brackets, samples);
  const int n_channels = acquire::n_channels(brackets.front().front().layout);
  for (int channel = 0; channel < n_channels; ++channel) {
    SampledPixels& pixels = samples.channels.emplace_back();
    for (const Candidate& c : choose_pixels(brackets, channel, options)) {
      const std::size_t start = pixels.observations.size();
      for (const OrderedFrame& f : ordered[c.bracket]) {
        const std::uint16_t value = f.frame->data[c.index];
        seen[value] = 1;
        if (value >= options.lowest_value && value < options.saturation_value) pixels.observations.push_back({value, f.time});
      }
      if (pixels.observations.size() == start || samples.times[pixels.observations[start].time] == samples.times[pixels.observations.back().time])
        pixels.observations.resize(start);  // no ratio of two times: nothing to learn
      else
        pixels.first.push_back(pixels.observations.size());
    }
  }
  samples.unused_low_bits = unused_bits(seen, samples.bits);
  return samples;
}

}  // namespace lacquer::calib
