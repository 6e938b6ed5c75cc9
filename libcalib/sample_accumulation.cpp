#include <tbb/parallel_for.h>
#include <tbb/parallel_pipeline.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <glm/geometric.hpp>

#include "libbrdf/vector_math.h"
#include "libcalib/samples.h"

namespace lacquer::calib {

KernelView Sampler::kernel_view(const View& view) const {
  return {.sphere_radius = calibration_.geometry.sphere_radius,
          .central = central(),
          .camera = camera_,
          .distant = view.light.distant,
          .light = view.light.distant ? view.light.direction : view.light.position,
          .axis = view.light.axis,
          .falloff_exponent = static_cast<float>(view.light.falloff_exponent),
          .diameter = static_cast<float>(view.light.diameter),
          .min_cosine = static_cast<float>(view.min_cosine),
          .narrowest_m = static_cast<float>(options_.narrowest_m),
          .reference = static_cast<float>(view.reference)};
}

/// What float could not decide, by the scalar code.
PixelFate Sampler::resolve(const View& view, const SpherePixels& pixels, std::size_t i, PixelSample& sample, std::uint32_t& slot) const {
  const Lit lit = light(view, pixels, i);
  if (lit.fate != PixelFate::used) return lit.fate;
  using Grid = brdf::TableGrid;
  const Grid::Cell cell = Grid::cell(lit.coordinates);
  const brdf::HalfDiff centre = Grid::centre(cell);
  const auto weighted = [&](double x) { return static_cast<float>(lit.weight * x); };
  const double offset = lit.coordinates.theta_h - centre.theta_h, squared_slope = brdf::reachable_cells().squared_slope(cell.theta_h);
  sample = {.weight = static_cast<float>(lit.weight),
            .theta_h = weighted(offset),
            .theta_d = weighted(lit.coordinates.theta_d - centre.theta_d),
            .phi_d = weighted(brdf::fold_phi_d(lit.coordinates.phi_d) - centre.phi_d),
            .along = weighted(lit.footprint.along + squared_slope * offset * offset),
            .across = weighted(lit.footprint.across),
            .mixed = weighted(lit.footprint.mixed),
            .none = 0};
  slot = brdf::reachable_cells().slot(cell.theta_h * Grid::n_theta_d + cell.theta_d, cell.phi_d);
  return PixelFate::used;
}

namespace {

using brdf::Float8;
using brdf::Int32x8;
using brdf::load;
using brdf::splat;
using brdf::store;
using brdf::UInt32x8;

LACQUER_ALWAYS_INLINE bool any(Int32x8 m) { return brdf::any((brdf::Int64x4)m); }
constexpr std::uint64_t first_of_two_bytes = std::endian::native == std::endian::little ? 0x0001000100010001u : 0x0100010001000100u;

/// One channel of an image, as far as it becomes samples.
struct ImageChannel {
  const RadianceImage& image;
  const SpherePixels& pixels;
  std::size_t per_pixel, offset;  // values of the image
  float scale;                    // radiance times this: f_r times the sample's weight
  std::size_t table_channel;
};

/// The values of a block's samples in one channel.
struct BlockValues {
  alignas(32) float value[SampleBlock::size], variance[SampleBlock::size];  // times the weight, times its square
  std::uint32_t slot[SampleBlock::size];                        // of the cell; no cell's for what is no value
  struct Bound {
    std::uint32_t place, slot;
  };
  Bound bounds[SampleBlock::size];
  std::size_t n_bounds;
  SampleCounts counts;
};

/// A block of pixels on its way from the threads that compute to those that add, one for each channel.
struct Block {
  std::size_t first, n;  // pixels
  SampleBlock samples;
  std::array<BlockValues, 3> channels;  // of a pixel
};

/// Eight pixels' values as they stand in the image.
struct EightValues {
  Float8 radiance, variance;
  bool odd;  ///< one of them is clipped or invalid
};
static_assert((static_cast<unsigned>(PixelFlag::clipped) & static_cast<unsigned>(PixelFlag::invalid) & 1) == 1);
static_assert(((static_cast<unsigned>(PixelFlag::valid) | static_cast<unsigned>(PixelFlag::dark)) & 1) == 0);

LACQUER_ALWAYS_INLINE Float8 every_second(const float* v) {
  return __builtin_shufflevector(load<Float8>(v), load<Float8>(v + 8), 0, 2, 4, 6, 8, 10, 12, 14);
}

LACQUER_ALWAYS_INLINE EightValues eight_values(const ImageChannel& from, const PixelGroup& pixels) {
  const RadianceImage& image = from.image;
  const UInt32x8 index = load<UInt32x8>(pixels.index);
  if (from.per_pixel == 1 && index[0] + 16 <= image.radiance.size() && !any((Int32x8)(index - index[0]) != Int32x8{0, 2, 4, 6, 8, 10, 12, 14})) {
    std::uint64_t flags[2];
    std::memcpy(flags, image.flags.data() + index[0], sizeof flags);
    return {every_second(&image.radiance[index[0]]), every_second(&image.variance[index[0]]), ((flags[0] | flags[1]) & first_of_two_bytes) != 0};
  }
  EightValues v;
  unsigned flags = 0;
  for (std::size_t k = 0; k < SampleBlock::width; ++k) {
    const std::size_t value = pixels.index[k] * from.per_pixel + from.offset;
    v.radiance[k] = image.radiance[value];
    v.variance[k] = image.variance[value];
    flags |= static_cast<unsigned>(image.flags[value]);
  }
  v.odd = (flags & 1) != 0;
  return v;
}

LACQUER_ALWAYS_INLINE void values_body(const SampleBlock& samples, std::size_t first, const ImageChannel& from, BlockValues& to) {
  constexpr std::size_t width = SampleBlock::width, ahead = 10;
  const std::uint32_t no_slot = brdf::reachable_cells().size();
  to.counts = {};
  to.n_bounds = 0;
  UInt32x8 n_lit{};
  for (std::size_t g = 0; g < samples.n_groups; ++g) {
    const std::size_t at = g * width;
    const PixelGroup& pixels = from.pixels.group(first + samples.group[g]);
    if (g + ahead < samples.n_groups) {  // the image's lines are too short for the processor to look that far ahead
      const std::size_t soon = from.pixels.group(first + samples.group[g + ahead]).index[0] * from.per_pixel + from.offset;
      __builtin_prefetch(&from.image.radiance[soon]);
      __builtin_prefetch(&from.image.variance[soon]);
      __builtin_prefetch(&from.image.flags[soon]);
    }
    const EightValues v = eight_values(from, pixels);
    const Float8 factor = splat(from.scale) * load<Float8>(pixels.inverse_transmission);
    const UInt32x8 slot = load<UInt32x8>(samples.slot + at);
    store(to.value + at, v.radiance * factor);
    store(to.variance + at, v.variance * (factor * factor));
    store(to.slot + at, slot);
    n_lit -= (UInt32x8)(slot != no_slot);
    if (!v.odd) continue;
    for (std::size_t place = at; place < at + width; ++place) {
      const PixelFlag flag = from.image.flags[pixels.index[place - at] * from.per_pixel + from.offset];
      if (to.slot[place] == no_slot || (flag != PixelFlag::clipped && flag != PixelFlag::invalid)) continue;
      if (flag == PixelFlag::clipped) to.bounds[to.n_bounds++] = {static_cast<std::uint32_t>(place), to.slot[place]};
      else ++to.counts.invalid;
      to.slot[place] = no_slot;
    }
  }
  to.counts.clipped = to.n_bounds;
  to.counts.used = 0;
  for (std::size_t k = 0; k < width; ++k) to.counts.used += n_lit[k];
  to.counts.used -= to.counts.clipped + to.counts.invalid;
}

void prefetch(const brdf::CellSums& sums) {
  __builtin_prefetch(&sums, 1);
  __builtin_prefetch(&sums.mixed, 1);  // a cell may lie in two cache lines
}

/// Adds a block's values to their cells, in an order that does not depend on the threads.
LACQUER_ALWAYS_INLINE void add_body(const SampleBlock& samples, const BlockValues& values, brdf::CellSums* cells) {
  // Neighbours share cells, and adding twice to one cell takes the second time until the first is written: four groups take turns.
  constexpr std::size_t turns = 4, width = SampleBlock::width, look_ahead = 64;
  const std::size_t n = samples.n_groups * width;
  std::size_t fetched = 0;
  for (std::size_t first = 0; first < n; first += turns * width) {
    const std::size_t end = std::min(n, first + turns * width);
    for (const std::size_t soon = std::min(n, end + look_ahead); fetched < soon; ++fetched) prefetch(cells[values.slot[fetched]]);
    for (std::size_t k = first; k < first + width; ++k)
      for (std::size_t i = k; i < end; i += width) {
        const PixelSample& s = samples.sample[i];
        cells[values.slot[i]].add_value(s.weight, values.value[i], values.variance[i], &s.weight);
      }
  }
  // A cell's values and bounds may come in any order.
  for (std::size_t b = 0; b < values.n_bounds; ++b) {
    const auto [i, slot] = values.bounds[b];
    const PixelSample& s = samples.sample[i];
    cells[slot].add({.weight = s.weight, .value = values.value[i], .variance = values.variance[i], .theta_h = s.theta_h, .theta_d = s.theta_d,
                     .phi_d = s.phi_d, .along = s.along, .across = s.across, .mixed = s.mixed, .count = 1, .bounds = 1});
  }
}

// Bytes are the same with and without AVX2.
#ifdef LACQUER_TARGET_AVX2
LACQUER_TARGET_AVX2 void values_avx2(const SampleBlock& samples, std::size_t first, const ImageChannel& from, BlockValues& to) {
  values_body(samples, first, from, to);
}
LACQUER_TARGET_AVX2 void add_avx2(const SampleBlock& samples, const BlockValues& values, brdf::CellSums* cells) { add_body(samples, values, cells); }
const bool has_avx2 = __builtin_cpu_supports("avx2");
#endif

void read_values(const SampleBlock& samples, std::size_t first, const ImageChannel& from, BlockValues& to) {
#ifdef LACQUER_TARGET_AVX2
  if (has_avx2) return values_avx2(samples, first, from, to);
#endif
  values_body(samples, first, from, to);
}

void add_block(const SampleBlock& samples, const BlockValues& values, brdf::CellSums* cells) {
#ifdef LACQUER_TARGET_AVX2
  if (has_avx2) return add_avx2(samples, values, cells);
#endif
  add_body(samples, values, cells);
}

}  // namespace

SampleCounts Sampler::accumulate_view(const RadianceImage& image, const Illumination& lighting, brdf::TableAccumulator& accumulator) const {
  check(image);
  const View view = view_of(lighting);
  const KernelView kernel = kernel_view(view);
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(layout_));

  // Of each channel one thread after the other adds, in the order of the pixels; different channels add at the same time.
  std::array<std::array<SampleCounts, 3>, 3> counts;  // by part of the mosaic and value of the pixel
  tbb::parallel_for(std::size_t{0}, parts_.size(), [&](std::size_t part) {
    const SpherePixels& pixels = parts_[part];
    std::vector<ImageChannel> channels;
    for (std::size_t c = 0; c < per_pixel; ++c) {
      const std::size_t channel = per_pixel > 1 ? c : static_cast<std::size_t>(pixels.channel);
      // Summed radiance over summed irradiance: w f = radiance * scale, without the irradiance that w is relative to.
      const auto i = static_cast<int>(channel);
      const double scale = 1 / (calibration_.dn_per_radiance[i] * view.light.intensity[i] * view.reference);
      channels.push_back({image, pixels, per_pixel, c, static_cast<float>(scale), channel});
    }
    constexpr std::size_t in_flight = 4;  // blocks of some 25 KB: they stay in the cache between the steps
    std::array<Block, in_flight> blocks;
    std::size_t first = 0, next = 0;
    tbb::filter<void, Block*> chain =
        tbb::make_filter<void, Block*>(tbb::filter_mode::serial_in_order, [&](tbb::flow_control& control) -> Block* {
          if (first >= pixels.size) {
            control.stop();
            return nullptr;
          }
          Block& block = blocks[next++ % in_flight];
          block.first = first;
          block.n = std::min(SampleBlock::size, pixels.size - first);
          first += block.n;
          return &block;
        }) &
        tbb::make_filter<Block*, Block*>(tbb::filter_mode::parallel, [&](Block* block) {
          SampleBlock& samples = block->samples;
          sample_block(pixels, block->first, block->n, kernel, samples);
          for (std::size_t d = 0; d < samples.n_doubtful; ++d) {
            const std::size_t at = samples.doubtful[d], pixel = block->first + samples.group[at / SampleBlock::width] + at % SampleBlock::width;
            samples.n_blurred += resolve(view, pixels, pixel, samples.sample[at], samples.slot[at]) == PixelFate::blurred;
          }
          for (const ImageChannel& channel : channels) read_values(samples, block->first, channel, block->channels[channel.offset]);
          block->channels[0].counts.blurred = samples.n_blurred * per_pixel;
          return block;
        });
    for (const ImageChannel& channel : channels)
      chain = chain & tbb::make_filter<Block*, Block*>(tbb::filter_mode::serial_in_order, [&, &found = counts[part][channel.offset]](Block* block) {
                add_block(block->samples, block->channels[channel.offset], accumulator.cells(channel.table_channel));
                found += block->channels[channel.offset].counts;
                return block;
              });
    tbb::parallel_pipeline(in_flight, chain & tbb::make_filter<Block*, void>(tbb::filter_mode::parallel, [](Block*) {}));
  }, tbb::simple_partitioner());
  SampleCounts sum;
  for (const auto& part : counts)
    for (const SampleCounts& found : part) sum += found;
  sum.masked = n_masked_ * per_pixel;
  sum.grazing = n_pixels() * per_pixel - sum.used - sum.clipped - sum.invalid - sum.blurred;
  return sum;
}

}  // namespace lacquer::calib
