#include "libcalib/bracket_samples.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
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

void check_frame(const RawFrame& f, const RawFrame& first, std::size_t i, std::size_t n) {
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
  if (f.data.size() != first.data.size())
    fail(i, n, fmt::format("data: expected {} values, got {}", first.data.size(), f.data.size()));
  const auto limit = static_cast<std::uint32_t>(1u << f.bits);
  // A plain reduction instead of find_if: it vectorises, and bad frames are rare.
  std::uint32_t largest = 0;
  for (const std::uint16_t v : f.data) largest = std::max<std::uint32_t>(largest, v);
  if (largest >= limit) fail(i, n, fmt::format("value {}: expected less than 2^{} = {}", largest, f.bits, limit));
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

/// Frames of each bracket in the order of their exposure, with the index of that time in `times`.
struct OrderedFrame {
  const RawFrame* frame;
  std::uint16_t time;
};

std::vector<std::vector<OrderedFrame>> order_frames(std::span<const std::vector<RawFrame>> brackets, std::vector<double>& times) {
  for (const auto& bracket : brackets)
    for (const RawFrame& f : bracket) times.push_back(f.actual.exposure_s);
  std::sort(times.begin(), times.end());
  times.erase(std::unique(times.begin(), times.end()), times.end());
  if (times.size() > 65535) throw Error(ErrorCode::input, "brackets: expected at most 65535 different exposure times");
  std::vector<std::vector<OrderedFrame>> ordered;
  for (const auto& bracket : brackets) {
    auto& frames = ordered.emplace_back();
    for (const RawFrame& f : bracket)
      frames.push_back({&f, static_cast<std::uint16_t>(
                                std::lower_bound(times.begin(), times.end(), f.actual.exposure_s) - times.begin())});
    std::stable_sort(frames.begin(), frames.end(), [](const auto& a, const auto& b) { return a.time < b.time; });
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

void check_bracket(std::span<const RawFrame> frames) {
  if (frames.empty()) throw Error(ErrorCode::input, "bracket: expected at least one frame, got none");
  const RawFrame& first = frames.front();
  if (first.bits < 8 || first.bits > 16) fail(0, frames.size(), fmt::format("bits: expected 8 to 16, got {}", first.bits));
  if (first.width < 1 || first.height < 1)
    fail(0, frames.size(), fmt::format("size: expected at least 1 x 1, got {} x {}", first.width, first.height));
  const std::size_t expected = static_cast<std::size_t>(first.width) * static_cast<std::size_t>(first.height) *
                               static_cast<std::size_t>(acquire::values_per_pixel(first.layout));
  if (first.data.size() != expected)
    fail(0, frames.size(), fmt::format("data: expected {} values, got {}", expected, first.data.size()));
  for (std::size_t i = 0; i < frames.size(); ++i) check_frame(frames[i], first, i, frames.size());
}

BracketSamples sample_brackets(std::span<const std::vector<RawFrame>> brackets, const SamplingOptions& options) {
  check_brackets(brackets);
  BracketSamples samples;
  const auto ordered = order_frames(brackets, samples.times);
  const int n_channels = acquire::n_channels(brackets.front().front().layout);
  for (int channel = 0; channel < n_channels; ++channel) {
    SampledPixels& pixels = samples.channels.emplace_back();
    for (const Candidate& c : choose_pixels(brackets, channel, options)) {
      const std::size_t start = pixels.observations.size();
      for (const OrderedFrame& f : ordered[c.bracket]) {
        const std::uint16_t value = f.frame->data[c.index];
        if (value >= options.lowest_value && value < options.saturation_value) pixels.observations.push_back({value, f.time});
      }
      if (pixels.observations.size() == start || pixels.observations[start].time == pixels.observations.back().time)
        pixels.observations.resize(start);  // no ratio of two times: nothing to learn
      else
        pixels.first.push_back(pixels.observations.size());
    }
  }
  return samples;
}

}  // namespace lacquer::calib
