#include "libcalib/merge.h"

#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstring>
#include <optional>

#include "libbrdf/error.h"
#include "libcalib/bracket_samples.h"
#include "libcalib/merge_finish.h"
#include "libcalib/merge_kernels.h"
#include "libcalib/merge_weights.h"

namespace lacquer::calib {

namespace {

using acquire::RawFrame;

constexpr std::size_t max_frames = 64;
/// Values merged together: their sums stay in the first-level cache. A multiple of 2 and 3, so that channels keep their place.
constexpr std::size_t tile_size = 768;

void check_response(const Response& response, int bits, acquire::PixelLayout layout) {
  const auto n_values = std::size_t{1} << bits;
  if (response.bits != bits)
    throw Error(ErrorCode::input, fmt::format("response: bits: expected {} as the frames have, got {}", bits, response.bits));
  if (response.curves.size() != static_cast<std::size_t>(acquire::n_channels(layout)))
    throw Error(ErrorCode::input, fmt::format("response: curves: expected {} for layout {}, got {}", acquire::n_channels(layout),
                                              acquire::name_of(layout), response.curves.size()));
  for (const ResponseCurve& curve : response.curves) {
    if (curve.exposure.size() != n_values)
      throw Error(ErrorCode::input, fmt::format("response: curve: expected {} values, got {}", n_values, curve.exposure.size()));
    for (std::size_t v = 0; v < n_values; ++v)
      if (!std::isfinite(curve.exposure[v]) || (v > 0 && !(curve.exposure[v] > curve.exposure[v - 1])))
        throw Error(ErrorCode::input, fmt::format("response: curve: expected finite, strictly increasing values, entry {} is not", v));
  }
}

/// The values of an image in stretches whose channels repeat with `period`: rows of a mosaic, else the whole image at once.
struct Stretches {
  std::size_t n, size, period;
  acquire::PixelLayout layout;

  Stretches(int width, int height, acquire::PixelLayout pixel_layout) : layout(pixel_layout) {
    const std::size_t row = static_cast<std::size_t>(width) * static_cast<std::size_t>(acquire::values_per_pixel(layout));
    const bool one = layout == acquire::PixelLayout::mono || layout == acquire::PixelLayout::rgb;
    n = one ? 1 : static_cast<std::size_t>(height);
    size = one ? row * static_cast<std::size_t>(height) : row;
    period = layout == acquire::PixelLayout::mono ? 1 : (one ? 3 : 2);
  }
  /// Channel of the values i, i + period, ... of a stretch.
  std::array<std::size_t, 3> channels(std::size_t stretch) const {
    std::array<std::size_t, 3> channel{};
    for (std::size_t i = 0; i < period; ++i)
      channel[i] = static_cast<std::size_t>(layout == acquire::PixelLayout::rgb
                                                ? acquire::channel_of(layout, 0, 0, static_cast<int>(i))
                                                : acquire::channel_of(layout, static_cast<int>(i), static_cast<int>(stretch % 2), 0));
    return channel;
  }
  std::size_t tiles_per_stretch() const { return (size + tile_size - 1) / tile_size; }

  /// work(first value, number of values, channels) for every tile, in parallel.
  template <typename Work>
  void for_each_tile(const Work& work) const {
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, n * tiles_per_stretch(), 4), [&](const tbb::blocked_range<std::size_t>& tiles) {
      for (std::size_t tile = tiles.begin(); tile != tiles.end(); ++tile) {
        const std::size_t stretch = tile / tiles_per_stretch(), start = tile % tiles_per_stretch() * tile_size;
        work(stretch * size + start, std::min(tile_size, size - start), channels(stretch));
      }
    });
  }
};

ExposureValues exposure_values(const SensorTables& tables, const RawFrame& frame, std::size_t index, std::size_t first) {
  const auto basis = time_basis(frame.actual.exposure_s);
  return {frame.data.data() + first, static_cast<float>(basis[1]), static_cast<float>(basis[2]), std::uint32_t{1} << (index % 32),
          tables.is_shortest(frame.actual.exposure_s)};
}

/// Frames by time, equal times by content: any order of the input gives the same bytes.
std::vector<const RawFrame*> sorted_frames(std::span<const RawFrame> frames) {
  std::vector<const RawFrame*> sorted;
  for (const RawFrame& f : frames) sorted.push_back(&f);
  std::sort(sorted.begin(), sorted.end(), [](const RawFrame* a, const RawFrame* b) {
    if (a->actual.exposure_s != b->actual.exposure_s) return a->actual.exposure_s < b->actual.exposure_s;
    return std::memcmp(a->data.data(), b->data.data(), a->data.size() * sizeof(std::uint16_t)) < 0;
  });
  return sorted;
}

void check_count(std::size_t n) {
  if (n > max_frames)
    throw Error(ErrorCode::input, fmt::format("bracket: expected at most {} frames, got {}; average repeated exposures first", max_frames, n));
}

void resize(RadianceImage& image, const RawFrame& frame) {
  image.width = frame.width, image.height = frame.height, image.layout = frame.layout;
  image.radiance.resize(frame.data.size());
  image.variance.resize(frame.data.size());
  image.flags.resize(frame.data.size());
}

}  // namespace

void merge_bracket(std::span<const RawFrame> frames, const Response& response, const NoiseModel& noise, const SensorMaps& maps,
                   RadianceImage& image) {
  check_bracket_format(frames);
  check_count(frames.size());
  const RawFrame& format = frames.front();
  check_response(response, format.bits, format.layout);
  noise.validate();
  if (!maps.empty()) maps.validate(format.width, format.height, format.layout);

  const auto sorted = sorted_frames(frames);
  std::vector<double> times;
  for (const RawFrame* f : sorted) times.push_back(f->actual.exposure_s);
  const SensorTables tables(response, noise, times.front());
  const MergeFinish finish(tables, noise, times, maps);
  resize(image, format);
  const Stretches stretches(format.width, format.height, format.layout);
  const std::size_t planes = (frames.size() + 31) / 32;
  std::atomic<bool> in_range = true;
  stretches.for_each_tile([&](std::size_t first, std::size_t n, const std::array<std::size_t, 3>& channels) {
    alignas(64) std::array<std::array<float, tile_size>, n_sums> sums;
    alignas(64) std::array<std::array<std::uint32_t, tile_size>, 2> usable;
    for (auto& s : sums) std::fill_n(s.begin(), n, 0.0f);
    for (std::size_t p = 0; p < 2; ++p) std::fill_n(usable[p].begin(), p < planes ? n : 0, 0u);
    const ValueMeaning meaning = tables.meaning(channels, stretches.period);
    std::array<ExposureValues, max_frames> exposures;
    for (std::size_t j = 0; j < sorted.size(); ++j) exposures[j] = exposure_values(tables, *sorted[j], j, first);
    for (std::size_t p = 0; p < planes; ++p) {
      const SumsView view{{sums[0].data(), sums[1].data(), sums[2].data()}, usable[p].data()};
      if (!add_exposures(&exposures[32 * p], std::min<std::size_t>(sorted.size() - 32 * p, 32), n, meaning, view)) in_range = false;
    }
    finish.store({{sums[0].data(), sums[1].data(), sums[2].data()}, usable[0].data(), planes > 1 ? usable[1].data() : nullptr}, first, n,
                 channels, stretches.period, image);
  });
  if (!in_range) check_bracket(frames);  // throws, naming the frame
}

RadianceImage merge_bracket(std::span<const RawFrame> frames, const Response& response, const NoiseModel& noise, const SensorMaps& maps) {
  RadianceImage image;
  merge_bracket(frames, response, noise, maps, image);
  return image;
}

struct BracketMerger::State {
  Response response;
  NoiseModel noise;
  SensorMaps maps;
  std::vector<double> planned_times;
  std::optional<SensorTables> tables;  ///< made with the first frame of the first view
  RawFrame format;                     ///< of the view; without its data
  std::vector<double> times;           ///< of the frames so far
  std::array<std::vector<float>, n_sums> sums;
  std::array<std::vector<std::uint32_t>, 2> usable;
};

BracketMerger::BracketMerger(const Response& response, const NoiseModel& noise, std::vector<double> planned_times, SensorMaps maps)
    : state_(new State{response, noise, std::move(maps), std::move(planned_times), {}, {}, {}, {}, {}}) {
  if (state_->planned_times.empty()) throw Error(ErrorCode::input, "bracket: expected at least one frame, got none");
  check_count(state_->planned_times.size());
  noise.validate();
}

BracketMerger::~BracketMerger() = default;

std::size_t BracketMerger::n_frames() const { return state_->times.size(); }

void BracketMerger::add(const RawFrame& frame) {
  State& s = *state_;
  const std::size_t index = s.times.size(), n_planned = s.planned_times.size();
  if (index >= n_planned) throw Error(ErrorCode::input, fmt::format("bracket: expected {} frames as planned, got one more", n_planned));
  check_frame_format(frame, index == 0 ? frame : s.format, index, n_planned);
  if (index == 0) {
    check_response(s.response, frame.bits, frame.layout);
    if (!s.maps.empty()) s.maps.validate(frame.width, frame.height, frame.layout);
    s.format = {frame.width, frame.height, frame.layout, frame.bits, {}, frame.actual};
    for (auto& sum : s.sums) sum.assign(frame.data.size(), 0.0f);
    for (std::size_t p = 0; p < 2; ++p) s.usable[p].assign(n_planned > 32 * p ? frame.data.size() : 0, 0u);
  }
  const double shortest_planned = *std::min_element(s.planned_times.begin(), s.planned_times.end());
  if (!s.tables) s.tables.emplace(s.response, s.noise, shortest_planned);
  const Stretches stretches(frame.width, frame.height, frame.layout);
  std::atomic<bool> in_range = true;
  stretches.for_each_tile([&](std::size_t first, std::size_t n, const std::array<std::size_t, 3>& channels) {
    const SumsView view{{s.sums[0].data() + first, s.sums[1].data() + first, s.sums[2].data() + first},
                        s.usable[index / 32].data() + first};
    const ExposureValues exposure = exposure_values(*s.tables, frame, index, first);
    if (!add_exposures(&exposure, 1, n, s.tables->meaning(channels, stretches.period), view)) in_range = false;
  });
  if (!in_range) {
    s.times.clear();  // the sums are spoilt: the view begins anew
    check_frame_values(frame, index, n_planned);
  }
  s.times.push_back(frame.actual.exposure_s);
}

RadianceImage BracketMerger::finish() {
  State& s = *state_;
  if (s.times.empty()) throw Error(ErrorCode::input, "bracket: expected at least one frame, got none");
  const MergeFinish finish(*s.tables, s.noise, s.times, s.maps);
  RadianceImage image{s.format.width, s.format.height, s.format.layout, {}, {}, {}};
  image.radiance.resize(s.sums[0].size());
  image.variance.resize(s.sums[0].size());
  image.flags.resize(s.sums[0].size());
  const Stretches stretches(image.width, image.height, image.layout);
  stretches.for_each_tile([&](std::size_t first, std::size_t n, const std::array<std::size_t, 3>& channels) {
    finish.store({{s.sums[0].data() + first, s.sums[1].data() + first, s.sums[2].data() + first},
                  s.usable[0].data() + first,
                  s.times.size() > 32 ? s.usable[1].data() + first : nullptr},
                 first, n, channels, stretches.period, image);
  });
  s.times.clear();
  return image;
}

}  // namespace lacquer::calib
