#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <glm/geometric.hpp>
#include <memory>
#include <span>
#include <vector>

#include "libcalib/in_order.h"
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
PixelFate Sampler::resolve(const View& view, const SpherePixels& pixels, std::size_t i, SampleBlock& to, std::size_t at) const {
  const Lit lit = light(view, pixels, i);
  if (lit.fate != PixelFate::used) return lit.fate;
  using Grid = brdf::TableGrid;
  const Grid::Cell cell = Grid::cell(lit.coordinates);
  const brdf::HalfDiff centre = Grid::centre(cell);
  const auto weighted = [&](double x) { return static_cast<float>(lit.weight * x); };
  const double offset = lit.coordinates.theta_h - centre.theta_h, squared_slope = brdf::reachable_cells().squared_slope(cell.theta_h);
  to.weight[at] = static_cast<float>(lit.weight);
  to.theta_h[at] = weighted(offset);
  to.theta_d[at] = weighted(lit.coordinates.theta_d - centre.theta_d);
  to.phi_d[at] = weighted(brdf::fold_phi_d(lit.coordinates.phi_d) - centre.phi_d);
  to.along[at] = weighted(lit.footprint.along + squared_slope * offset * offset);
  to.across[at] = weighted(lit.footprint.across);
  to.mixed[at] = weighted(lit.footprint.mixed);
  to.slot[at] = brdf::reachable_cells().slot(cell.theta_h * Grid::n_theta_d + cell.theta_d, cell.phi_d);
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

/// What a block's pixels add to the cells of one channel.
struct BlockValues {
  alignas(32) float others[SampleBlock::size][8];  // see CellSums::add_value
  alignas(32) float sums[SampleBlock::size][2];
  alignas(32) std::uint32_t cell[SampleBlock::size];  // bytes from the first one; that of no cell for what is no value
  struct Bound {
    std::uint32_t place, cell;
  };
  Bound bounds[SampleBlock::size];
  std::size_t n, n_bounds;
  SampleCounts counts;
};

/// Eight pixels' values as they stand in the image.
struct EightValues {
  Float8 radiance, variance;
  bool odd;  ///< one of them, or of their neighbours, may be clipped or invalid
};
static_assert((static_cast<unsigned>(PixelFlag::clipped) & static_cast<unsigned>(PixelFlag::invalid) & 1) == 1);
static_assert(((static_cast<unsigned>(PixelFlag::valid) | static_cast<unsigned>(PixelFlag::dark)) & 1) == 0);

LACQUER_ALWAYS_INLINE Float8 every_second(const float* v) {
  return __builtin_shufflevector(load<Float8>(v), load<Float8>(v + 8), 0, 2, 4, 6, 8, 10, 12, 14);
}

/// Of any pixels, the first of them `pixel`. Not inlined: mosaics seldom need it.
[[gnu::noinline]] void gather_values(const ImageChannel& from, std::size_t pixel, EightValues& v) {
  unsigned flags = 0;
  for (std::size_t k = 0; k < SampleBlock::width; ++k) {
    const std::size_t value = from.pixels.index(pixel + k) * from.per_pixel + from.offset;
    v.radiance[k] = from.image.radiance[value];
    v.variance[k] = from.image.variance[value];
    flags |= static_cast<unsigned>(from.image.flags[value]);
  }
  v.odd = (flags & 1) != 0;
}

/// Every second value from `first` on.
LACQUER_ALWAYS_INLINE EightValues every_second(const RadianceImage& image, std::size_t first) {
  std::uint64_t flags[2];
  std::memcpy(flags, image.flags.data() + first, sizeof flags);
  return {every_second(&image.radiance[first]), every_second(&image.variance[first]), ((flags[0] | flags[1]) & first_of_two_bytes) != 0};
}

LACQUER_ALWAYS_INLINE EightValues eight_values(const ImageChannel& from, std::size_t pixel, const PixelGroup& group) {
  EightValues v;
  if (from.per_pixel != 1 || group.run == 0) [[unlikely]] {
    gather_values(from, pixel, v);
    return v;
  }
  v = every_second(from.image, group.first[0]);
  if (group.run < SampleBlock::width) {  // the end of a line and the begin of the next
    const EightValues next = every_second(from.image, group.first[1]);
    const Int32x8 is_first = Int32x8{0, 1, 2, 3, 4, 5, 6, 7} < static_cast<std::int32_t>(group.run);
    v = {select(is_first, v.radiance, next.radiance), select(is_first, v.variance, next.variance), v.odd || next.odd};
  }
  return v;
}

/// What is clipped or invalid among eight values is no value.
[[gnu::noinline]] void sort_out(const ImageChannel& from, std::size_t pixel, std::size_t at, std::uint32_t no_cell, BlockValues& to) {
  for (std::size_t place = at; place < at + SampleBlock::width; ++place) {
    const PixelFlag flag = from.image.flags[from.pixels.index(pixel + place - at) * from.per_pixel + from.offset];
    std::uint32_t& cell = to.cell[place];
    if (cell == no_cell || (flag != PixelFlag::clipped && flag != PixelFlag::invalid)) continue;
    if (flag == PixelFlag::clipped) to.bounds[to.n_bounds++] = {static_cast<std::uint32_t>(place), cell};
    else ++to.counts.invalid;
    cell = no_cell;
  }
}

/// Lane k of column j becomes member j of row k.
LACQUER_ALWAYS_INLINE void store_transposed(const Float8 (&c)[8], float (*to)[8]) {
  const Float8 p0 = low_pairs(c[0], c[1]), p1 = high_pairs(c[0], c[1]), p2 = low_pairs(c[2], c[3]), p3 = high_pairs(c[2], c[3]);
  const Float8 p4 = low_pairs(c[4], c[5]), p5 = high_pairs(c[4], c[5]), p6 = low_pairs(c[6], c[7]), p7 = high_pairs(c[6], c[7]);
  const Float8 left[4] = {low_fours(p0, p2), high_fours(p0, p2), low_fours(p1, p3), high_fours(p1, p3)};
  const Float8 right[4] = {low_fours(p4, p6), high_fours(p4, p6), low_fours(p5, p7), high_fours(p5, p7)};
  for (int k = 0; k < 4; ++k) {
    store(to[k], low_halves(left[k], right[k]));
    store(to[k + 4], high_halves(left[k], right[k]));
  }
}
LACQUER_ALWAYS_INLINE void store_transposed(Float8 first, Float8 second, float (*to)[2]) {
  const Float8 low = low_pairs(first, second), high = high_pairs(first, second);
  store(to[0], low_halves(low, high));
  store(to[4], high_halves(low, high));
}

LACQUER_ALWAYS_INLINE void values_body(const SampleBlock& samples, std::size_t first, const ImageChannel& channel, const brdf::CellSums* cells,
                                        BlockValues& to) {
  const ImageChannel from = channel;  // of this function alone: what is written cannot change it
  constexpr std::size_t width = SampleBlock::width, ahead = 16;
  const std::uint32_t no_slot = brdf::reachable_cells().size(), no_cell = no_slot * sizeof(brdf::CellSums);
  to.counts = {};
  to.n = samples.n_groups * width;
  to.n_bounds = 0;
  UInt32x8 n_lit{};
  const Float8 scale = splat(from.scale);
  for (std::size_t g = 0; g < samples.n_groups; ++g) {
    const std::size_t at = g * width, pixel = first + samples.group[g];
    const PixelGroup& pixels = from.pixels.group(pixel);
    if (g + ahead < samples.n_groups) {  // the image's lines are too short for the processor to look that far ahead
      const std::size_t soon = from.pixels.group(first + samples.group[g + ahead]).first[0] * from.per_pixel + from.offset;
      __builtin_prefetch(&from.image.radiance[soon]);
      __builtin_prefetch(&from.image.variance[soon]);
      __builtin_prefetch(&from.image.flags[soon]);
    }
    const EightValues v = eight_values(from, pixel, pixels);
    const Float8 factor = scale * load<Float8>(pixels.inverse_transmission);
    const UInt32x8 slot = load<UInt32x8>(samples.slot + at);
    store_transposed(load<Float8>(samples.weight + at), v.radiance * factor, to.sums + at);
    store_transposed({v.variance * (factor * factor), load<Float8>(samples.theta_h + at), load<Float8>(samples.theta_d + at), load<Float8>(samples.phi_d + at),
                      load<Float8>(samples.along + at), load<Float8>(samples.across + at), load<Float8>(samples.mixed + at), (Float8)(UInt32x8{} + 1u)},
                     to.others + at);
    store(to.cell + at, slot * std::uint32_t{sizeof(brdf::CellSums)});
    for (std::size_t place = at; place < at + width; ++place) {  // to be added to soon
      const char* const cell = reinterpret_cast<const char*>(cells) + to.cell[place];
      __builtin_prefetch(cell, 1);
      __builtin_prefetch(cell + sizeof(brdf::CellSums) - 1, 1);  // a cell may lie in two cache lines
    }
    n_lit -= (UInt32x8)(slot != no_slot);
    if (v.odd) sort_out(from, pixel, at, no_cell, to);
  }
  to.counts.clipped = to.n_bounds;
  to.counts.used = 0;
  for (std::size_t k = 0; k < width; ++k) to.counts.used += n_lit[k];
  to.counts.used -= to.counts.clipped + to.counts.invalid;
}

/// Adds a block's values to their cells, in an order that does not depend on the threads.
LACQUER_ALWAYS_INLINE void add_body(const BlockValues& values, brdf::CellSums* cells) {
  // Neighbours share cells, and adding twice to one cell takes the second time until the first is written: four groups take turns.
  constexpr std::size_t turns = 4, width = SampleBlock::width;
  const auto at = [&](std::uint32_t cell) { return reinterpret_cast<brdf::CellSums*>(reinterpret_cast<char*>(cells) + cell); };
  const auto add = [&](std::size_t i) { at(values.cell[i])->add_value(values.sums[i], values.others[i]); };
  std::size_t first = 0;
  for (; first + turns * width <= values.n; first += turns * width)
    for (std::size_t k = first; k < first + width; ++k) add(k), add(k + width), add(k + 2 * width), add(k + 3 * width);
  for (std::size_t k = first; k < first + width; ++k)
    for (std::size_t i = k; i < values.n; i += width) add(i);
  // A cell's values and bounds may come in any order.
  for (std::size_t b = 0; b < values.n_bounds; ++b) {
    const auto [i, cell] = values.bounds[b];
    const auto& [variance, theta_h, theta_d, phi_d, along, across, mixed, count] = values.others[i];
    at(cell)->add({.weight = double{values.sums[i][0]}, .value = double{values.sums[i][1]}, .variance = variance, .theta_h = theta_h, .theta_d = theta_d,
                   .phi_d = phi_d, .along = along, .across = across, .mixed = mixed, .count = 1, .bounds = 1});
  }
}

// Bytes are the same with and without AVX2.
#ifdef LACQUER_TARGET_AVX2
LACQUER_TARGET_AVX2 void values_avx2(const SampleBlock& samples, std::size_t first, const ImageChannel& from, const brdf::CellSums* cells,
                                     BlockValues& to) {
  values_body(samples, first, from, cells, to);
}
LACQUER_TARGET_AVX2 void add_avx2(const BlockValues& values, brdf::CellSums* cells) { add_body(values, cells); }
const bool has_avx2 = __builtin_cpu_supports("avx2");
#endif

/// `cells`: those that the values will be added to.
void read_values(const SampleBlock& samples, std::size_t first, const ImageChannel& from, const brdf::CellSums* cells, BlockValues& to) {
#ifdef LACQUER_TARGET_AVX2
  if (has_avx2) return values_avx2(samples, first, from, cells, to);
#endif
  values_body(samples, first, from, cells, to);
}

void add_block(const BlockValues& values, brdf::CellSums* cells) {
#ifdef LACQUER_TARGET_AVX2
  if (has_avx2) return add_avx2(values, cells);
#endif
  add_body(values, cells);
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

  const auto channel_of = [&](const SpherePixels& pixels, std::size_t offset) { return per_pixel > 1 ? offset : static_cast<std::size_t>(pixels.channel()); };
  const auto image_channel = [&](const LitView& lit, const SpherePixels& pixels, std::size_t offset) -> ImageChannel {
    // Summed radiance over summed irradiance: w f = radiance * scale, without the irradiance that w is relative to.
    const auto i = static_cast<int>(channel_of(pixels, offset));
    const double scale = 1 / (calibration_.dn_per_radiance[i] * lit.view.light.intensity[i] * lit.view.reference);
    return {lit.image, pixels, per_pixel, offset, static_cast<float>(scale)};
  };
  const auto n_threads = static_cast<std::size_t>(tbb::this_task_arena::max_concurrency());
  InOrder queue(blocks_.size(), 2 * n_threads);  // few, so that the blocks stay in the cache until they are added
  const std::size_t values_per_slot = views.size() * per_pixel;
  const auto values = std::make_unique_for_overwrite<BlockValues[]>(queue.n_slots() * values_per_slot);
  const auto values_of = [&](std::size_t slot, std::size_t view) { return std::span(&values[slot * values_per_slot + view * per_pixel], per_pixel); };
  SampleCounts sum;
  const auto compute = [&](std::size_t i, std::size_t slot) {
    const auto [part, first] = blocks_[i];
    const SpherePixels& pixels = parts_[part];
    const std::size_t n = std::min(SampleBlock::size, pixels.size() - first);
    SampleBlock samples;
    for (std::size_t v = 0; v < views.size(); ++v) {  // all views of the block while its pixels are in the cache
      views[v].kernel.sample(pixels, first, n, v == 0, samples);
      for (std::size_t d = 0; d < samples.n_doubtful; ++d) {
        const std::size_t at = samples.doubtful[d], pixel = first + samples.group[at / SampleBlock::width] + at % SampleBlock::width;
        samples.n_blurred += resolve(views[v].view, pixels, pixel, samples, at) == PixelFate::blurred;
      }
      const std::span<BlockValues> to = values_of(slot, v);
      for (std::size_t c = 0; c < per_pixel; ++c) read_values(samples, first, image_channel(views[v], pixels, c), accumulator.cells(channel_of(pixels, c)), to[c]);
      to[0].counts.blurred = samples.n_blurred * per_pixel;
    }
  };
  const auto add = [&](std::size_t i, std::size_t slot) {
    for (std::size_t v = 0; v < views.size(); ++v)
      for (std::size_t c = 0; c < per_pixel; ++c) {
        const BlockValues& from = values_of(slot, v)[c];
        add_block(from, accumulator.cells(channel_of(parts_[blocks_[i].part], c)));
        sum += from.counts;
      }
  };
  tbb::parallel_for(std::size_t{0}, n_threads, [&](std::size_t) { queue.work(compute, add); }, tbb::simple_partitioner());
  sum.masked = n_masked_ * per_pixel * images.size();
  sum.grazing = n_pixels() * per_pixel * images.size() - sum.used - sum.clipped - sum.invalid - sum.blurred;
  return sum;
}

}  // namespace lacquer::calib
