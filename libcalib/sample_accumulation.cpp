#include <tbb/parallel_for.h>
#include <tbb/parallel_pipeline.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <glm/geometric.hpp>

#include "libcalib/sample_kernel_math.h"
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

using namespace kernel;
constexpr std::uint64_t first_of_two_bytes = std::endian::native == std::endian::little ? 0x0001000100010001u : 0x0100010001000100u;

/// One channel of an image, as far as it becomes samples.
struct ImageChannel {
  const RadianceImage& image;
  const SpherePixels& pixels;
  std::size_t per_pixel, offset;  // values of the image
  float scale;                    // radiance times this: f_r times the sample's weight
};

/// What a sample adds to its cell in one channel, beside PixelSample.
struct alignas(16) CellValue {
  float weight, value, variance;  // the value times the weight, the variance times its square
  std::uint32_t cell;             // bytes from the first one; that of no cell for what is no value
};

/// The values of a block's samples in one channel.
struct BlockValues {
  alignas(32) CellValue values[SampleBlock::size];
  struct Bound {
    std::uint32_t place, cell;
  };
  Bound bounds[SampleBlock::size];
  std::size_t n_bounds;
  SampleCounts counts;
};

/// A block of pixels on its way from the threads that compute to those that add, one for each channel.
struct Block {
  struct Lit {
    SampleBlock samples;
    std::array<BlockValues, 3> channels;  // of a pixel
  };
  std::size_t first, n;  // pixels
  std::array<Lit, Sampler::views_at_once> views;
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

/// Of any pixels. Not inlined: mosaics seldom need it.
[[gnu::noinline]] void gather_values(const ImageChannel& from, const PixelGroup& pixels, EightValues& v) {
  unsigned flags = 0;
  for (std::size_t k = 0; k < SampleBlock::width; ++k) {
    const std::size_t value = pixels.index[k] * from.per_pixel + from.offset;
    v.radiance[k] = from.image.radiance[value];
    v.variance[k] = from.image.variance[value];
    flags |= static_cast<unsigned>(from.image.flags[value]);
  }
  v.odd = (flags & 1) != 0;
}

LACQUER_ALWAYS_INLINE EightValues eight_values(const ImageChannel& from, const PixelGroup& pixels) {
  const RadianceImage& image = from.image;
  const UInt32x8 index = load<UInt32x8>(pixels.index);
  EightValues v;
  if (from.per_pixel == 1 && index[0] + 16 <= image.radiance.size() && !any((Int32x8)(index - index[0]) != Int32x8{0, 2, 4, 6, 8, 10, 12, 14})) {
    std::uint64_t flags[2];
    std::memcpy(flags, image.flags.data() + index[0], sizeof flags);
    v = {every_second(&image.radiance[index[0]]), every_second(&image.variance[index[0]]), ((flags[0] | flags[1]) & first_of_two_bytes) != 0};
  } else {
    gather_values(from, pixels, v);
  }
  return v;
}

/// What is clipped or invalid among eight values is no value.
[[gnu::noinline]] void sort_out(const ImageChannel& from, const PixelGroup& pixels, std::size_t at, std::uint32_t no_cell, BlockValues& to) {
  for (std::size_t place = at; place < at + SampleBlock::width; ++place) {
    const PixelFlag flag = from.image.flags[pixels.index[place - at] * from.per_pixel + from.offset];
    std::uint32_t& cell = to.values[place].cell;
    if (cell == no_cell || (flag != PixelFlag::clipped && flag != PixelFlag::invalid)) continue;
    if (flag == PixelFlag::clipped) to.bounds[to.n_bounds++] = {static_cast<std::uint32_t>(place), cell};
    else ++to.counts.invalid;
    cell = no_cell;
  }
}

LACQUER_ALWAYS_INLINE void store_values(Float8 weight, Float8 value, Float8 variance, UInt32x8 cell, CellValue* to) {
  const Float8 first_low = low_pairs(weight, value), first_high = high_pairs(weight, value);
  const Float8 second_low = low_pairs(variance, (Float8)cell), second_high = high_pairs(variance, (Float8)cell);
  const Float8 rows[4] = {low_fours(first_low, second_low), high_fours(first_low, second_low), low_fours(first_high, second_high),
                          high_fours(first_high, second_high)};  // 0 and 4, 1 and 5, ...
  for (int k = 0; k < 2; ++k) {
    store(to + 2 * k, __builtin_shufflevector(rows[2 * k], rows[2 * k + 1], 0, 1, 2, 3, 8, 9, 10, 11));
    store(to + 2 * k + 4, __builtin_shufflevector(rows[2 * k], rows[2 * k + 1], 4, 5, 6, 7, 12, 13, 14, 15));
  }
}

LACQUER_ALWAYS_INLINE void values_body(const SampleBlock& samples, std::size_t first, const ImageChannel& channel, const brdf::CellSums* cells,
                                        BlockValues& to) {
  const ImageChannel from = channel;  // of this function alone: what is written cannot change it
  constexpr std::size_t width = SampleBlock::width, ahead = 10;
  const std::uint32_t no_slot = brdf::reachable_cells().size(), no_cell = no_slot * sizeof(brdf::CellSums);
  to.counts = {};
  to.n_bounds = 0;
  UInt32x8 n_lit{};
  const Float8 scale = splat(from.scale);
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
    const Float8 factor = scale * load<Float8>(pixels.inverse_transmission);
    const UInt32x8 slot = load<UInt32x8>(samples.slot + at);
    store_values(load<Float8>(samples.weight + at), v.radiance * factor, v.variance * (factor * factor), slot * std::uint32_t{sizeof(brdf::CellSums)},
                 to.values + at);
    for (std::size_t place = at; place < at + width; ++place) {  // to be added to soon
      const char* const cell = reinterpret_cast<const char*>(cells) + to.values[place].cell;
      __builtin_prefetch(cell, 1);
      __builtin_prefetch(cell + sizeof(brdf::CellSums) - 1, 1);  // a cell may lie in two cache lines
    }
    n_lit -= (UInt32x8)(slot != no_slot);
    if (v.odd) sort_out(from, pixels, at, no_cell, to);
  }
  to.counts.clipped = to.n_bounds;
  to.counts.used = 0;
  for (std::size_t k = 0; k < width; ++k) to.counts.used += n_lit[k];
  to.counts.used -= to.counts.clipped + to.counts.invalid;
}

/// Adds a block's values to their cells, in an order that does not depend on the threads.
LACQUER_ALWAYS_INLINE void add_body(const SampleBlock& samples, const BlockValues& values, brdf::CellSums* cells) {
  // Neighbours share cells, and adding twice to one cell takes the second time until the first is written: four groups take turns.
  constexpr std::size_t turns = 4, width = SampleBlock::width;
  const auto at = [&](std::uint32_t cell) { return reinterpret_cast<brdf::CellSums*>(reinterpret_cast<char*>(cells) + cell); };
  const auto add = [&](std::size_t i) {
    const CellValue& v = values.values[i];
    at(v.cell)->add_value(&v.weight, &samples.sample[i].weight);
  };
  const std::size_t n = samples.n_groups * width;
  std::size_t first = 0;
  for (; first + turns * width <= n; first += turns * width)
    for (std::size_t k = first; k < first + width; ++k) add(k), add(k + width), add(k + 2 * width), add(k + 3 * width);
  for (std::size_t k = first; k < first + width; ++k)
    for (std::size_t i = k; i < n; i += width) add(i);
  // A cell's values and bounds may come in any order.
  for (std::size_t b = 0; b < values.n_bounds; ++b) {
    const auto [i, cell] = values.bounds[b];
    const PixelSample& s = samples.sample[i];
    const CellValue& v = values.values[i];
    at(cell)->add({.weight = v.weight, .value = v.value, .variance = v.variance, .theta_h = s.theta_h, .theta_d = s.theta_d,
                   .phi_d = s.phi_d, .along = s.along, .across = s.across, .mixed = s.mixed, .count = 1, .bounds = 1});
  }
}

// Bytes are the same with and without AVX2.
#ifdef LACQUER_TARGET_AVX2
LACQUER_TARGET_AVX2 void values_avx2(const SampleBlock& samples, std::size_t first, const ImageChannel& from, const brdf::CellSums* cells,
                                     BlockValues& to) {
  values_body(samples, first, from, cells, to);
}
LACQUER_TARGET_AVX2 void add_avx2(const SampleBlock& samples, const BlockValues& values, brdf::CellSums* cells) { add_body(samples, values, cells); }
const bool has_avx2 = __builtin_cpu_supports("avx2");
#endif

/// `cells`: those that the values will be added to.
void read_values(const SampleBlock& samples, std::size_t first, const ImageChannel& from, const brdf::CellSums* cells, BlockValues& to) {
#ifdef LACQUER_TARGET_AVX2
  if (has_avx2) return values_avx2(samples, first, from, cells, to);
#endif
  values_body(samples, first, from, cells, to);
}

void add_block(const SampleBlock& samples, const BlockValues& values, brdf::CellSums* cells) {
#ifdef LACQUER_TARGET_AVX2
  if (has_avx2) return add_avx2(samples, values, cells);
#endif
  add_body(samples, values, cells);
}

}  // namespace

SampleCounts Sampler::accumulate_views(std::span<const LitImage> images, brdf::TableAccumulator& accumulator) const {
  SampleCounts counts;
  for (std::size_t i = 0; i < images.size(); i += views_at_once)
    counts += accumulate_together(images.subspan(i, std::min(views_at_once, images.size() - i)), accumulator);
  return counts;
}

SampleCounts Sampler::accumulate_together(std::span<const LitImage> images, brdf::TableAccumulator& accumulator) const {
  struct LitView {
    const RadianceImage& image;
    View view;
    SampleKernel kernel;
  };
  std::vector<LitView> views;
  for (const LitImage& lit : images) {
    check(*lit.image);
    const View view = view_of(lit.lighting);
    views.push_back({*lit.image, view, SampleKernel(kernel_view(view))});
  }
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(layout_));

  // Of each channel one thread after the other adds, in the order of the pixels; different channels add at the same time.
  std::array<std::array<SampleCounts, 3>, 3> counts;  // by part of the mosaic and value of the pixel
  tbb::parallel_for(std::size_t{0}, parts_.size(), [&](std::size_t part) {
    const SpherePixels& pixels = parts_[part];
    const auto channel_of = [&](std::size_t offset) { return per_pixel > 1 ? offset : static_cast<std::size_t>(pixels.channel); };
    const auto image_channel = [&](const LitView& lit, std::size_t offset) -> ImageChannel {
      // Summed radiance over summed irradiance: w f = radiance * scale, without the irradiance that w is relative to.
      const auto i = static_cast<int>(channel_of(offset));
      const double scale = 1 / (calibration_.dn_per_radiance[i] * lit.view.light.intensity[i] * lit.view.reference);
      return {lit.image, pixels, per_pixel, offset, static_cast<float>(scale)};
    };
    constexpr std::size_t in_flight = 4;  // blocks of some 25 KB per view: they stay in the cache between the steps
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
          for (std::size_t v = 0; v < views.size(); ++v) {  // all views of the block while its pixels are in the cache
            SampleBlock& samples = block->views[v].samples;
            views[v].kernel.sample(pixels, block->first, block->n, v == 0, samples);
            for (std::size_t d = 0; d < samples.n_doubtful; ++d) {
              const std::size_t at = samples.doubtful[d], pixel = block->first + samples.group[at / SampleBlock::width] + at % SampleBlock::width;
              samples.n_blurred += resolve(views[v].view, pixels, pixel, samples.sample[at], samples.slot[at]) == PixelFate::blurred;
              samples.weight[at] = samples.sample[at].weight;
            }
            auto& channels = block->views[v].channels;
            for (std::size_t c = 0; c < per_pixel; ++c) read_values(samples, block->first, image_channel(views[v], c), accumulator.cells(channel_of(c)), channels[c]);
            channels[0].counts.blurred = samples.n_blurred * per_pixel;
          }
          return block;
        });
    for (std::size_t c = 0; c < per_pixel; ++c)
      chain = chain & tbb::make_filter<Block*, Block*>(tbb::filter_mode::serial_in_order, [&, c](Block* block) {
                for (std::size_t v = 0; v < views.size(); ++v) {
                  const auto& [samples, channels] = block->views[v];
                  add_block(samples, channels[c], accumulator.cells(channel_of(c)));
                  counts[part][c] += channels[c].counts;
                }
                return block;
              });
    tbb::parallel_pipeline(in_flight, chain & tbb::make_filter<Block*, void>(tbb::filter_mode::parallel, [](Block*) {}));
  }, tbb::simple_partitioner());
  SampleCounts sum;
  for (const auto& part : counts)
    for (const SampleCounts& found : part) sum += found;
  sum.masked = n_masked_ * per_pixel * images.size();
  sum.grazing = n_pixels() * per_pixel * images.size() - sum.used - sum.clipped - sum.invalid - sum.blurred;
  return sum;
}

}  // namespace lacquer::calib
