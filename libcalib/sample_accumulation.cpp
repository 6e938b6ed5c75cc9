#include <tbb/parallel_for.h>
#include <tbb/parallel_pipeline.h>

#include <algorithm>
#include <array>
#include <glm/geometric.hpp>

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
          .blur2 = static_cast<float>(view.blur2),
          .min_cosine = static_cast<float>(view.min_cosine),
          .narrowest_m = static_cast<float>(options_.narrowest_m),
          .reference = static_cast<float>(view.reference)};
}

/// What float could not decide, by the scalar code.
void Sampler::resolve(const View& view, const SpherePixels& pixels, std::size_t i, PixelSample& sample) const {
  const Lit lit = light(view, pixels, i);
  sample.place = PixelSample::packed(lit.fate, 0, 0, 0);
  if (lit.fate != PixelSample::used) return;
  using Grid = brdf::TableGrid;
  const Grid::Cell cell = Grid::cell(lit.coordinates);
  const brdf::HalfDiff centre = Grid::centre(cell);
  const auto weighted = [&](double x) { return static_cast<float>(lit.weight * x); };
  const double offset = lit.coordinates.theta_h - centre.theta_h, squared_slope = brdf::reachable_cells().squared_slope(cell.theta_h);
  sample = {.weight = static_cast<float>(lit.weight),
            .theta_h = weighted(offset),
            .theta_d = weighted(lit.coordinates.theta_d - centre.theta_d),
            .phi_d = weighted(brdf::fold_phi_d(lit.coordinates.phi_d) - centre.phi_d),
            .spread = {weighted(lit.footprint.along + squared_slope * offset * offset), weighted(lit.footprint.across), weighted(lit.footprint.mixed)},
            .place = PixelSample::packed(PixelSample::used, cell.theta_h, cell.theta_d, cell.phi_d)};
}

namespace {

/// A block of pixels on its way from the threads that compute to those that add, one for each channel.
struct Block {
  std::size_t first, n;  // pixels
  SampleBlock samples;
  std::uint32_t slot[SampleBlock::size];  // of the samples' cells; 0 where there is no sample
};

void find_slots(Block& block) {
  const brdf::ReachableCells& cells = brdf::reachable_cells();
  for (std::size_t k = 0; k < block.samples.n_groups * SampleBlock::width; ++k) {
    const PixelSample& s = block.samples.sample[k];
    block.slot[k] = s.fate() == PixelSample::used ? cells.slot(s.cell_theta_h() * brdf::TableGrid::n_theta_d + s.cell_theta_d(), s.cell_phi_d()) : 0;
  }
}

/// One channel of an image, as far as it becomes samples.
struct ImageChannel {
  const RadianceImage& image;
  const SpherePixels& pixels;
  std::size_t per_pixel, offset;  // values of the image
  float scale;                    // radiance times this: f_r times the sample's weight
  std::size_t table_channel;
};

/// Adds a block's values, in an order that does not depend on the threads. `count_pixels`: also what never became a sample.
void add_block(const Block& block, const ImageChannel& from, bool count_pixels, brdf::TableAccumulator& accumulator, SampleCounts& counts) {
  constexpr std::size_t width = SampleBlock::width;
  std::size_t n_blurred = 0, n_lit = 0;
  SampleCounts found;
  const auto add = [&](std::size_t g, std::size_t k) {
    const PixelSample& s = block.samples.sample[g * width + k];
    const std::size_t first = block.samples.group[g];
    if (first + k >= block.n) return;
    if (s.fate() != PixelSample::used) {
      n_blurred += s.fate() == PixelSample::blurred;
      return;
    }
    ++n_lit;
    const PixelGroup& pixels = from.pixels.group(block.first + first);
    const std::size_t value = pixels.index[k] * from.per_pixel + from.offset;
    const PixelFlag flag = from.image.flags[value];
    if (flag == PixelFlag::invalid) {
      ++found.invalid;
      return;
    }
    const float factor = from.scale * pixels.inverse_transmission[k];
    const float weighted_value = from.image.radiance[value] * factor, variance = from.image.variance[value] * (factor * factor);
    brdf::CellSums& sums = accumulator.cell(from.table_channel, block.slot[g * width + k]);
    if (flag == PixelFlag::clipped) {
      ++found.clipped;
      sums.add({.weight = s.weight, .value = weighted_value, .variance = variance, .theta_h = s.theta_h, .theta_d = s.theta_d, .phi_d = s.phi_d,
                .along = s.spread[0], .across = s.spread[1], .mixed = s.spread[2], .count = 1, .bounds = 1});
    } else {
      sums.add_value(s.weight, weighted_value, {variance, s.theta_h, s.theta_d, s.phi_d}, {s.spread[0], s.spread[1], s.spread[2], 0});
    }
  };
  // Neighbours share cells, and adding twice to one cell takes the second time until the first is written: four groups take turns.
  constexpr std::size_t turns = 4;
  const std::size_t n_groups = block.samples.n_groups;
  for (std::size_t first = 0; first < n_groups; first += turns) {
    const std::size_t end = std::min(n_groups, first + turns), soon = std::min(n_groups, end + turns);
    for (std::size_t k = end * width; k < soon * width; ++k) accumulator.prefetch(from.table_channel, block.slot[k]);
    for (std::size_t k = 0; k < width; ++k)
      for (std::size_t g = first; g < end; ++g) add(g, k);
  }
  found.used = n_lit - found.clipped - found.invalid;
  if (count_pixels) {
    found.blurred = n_blurred * from.per_pixel;
    found.grazing = (block.n - n_lit - n_blurred) * from.per_pixel;
  }
  counts += found;
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
    constexpr std::size_t in_flight = 4;  // blocks of 18 KB: they stay in the cache between the steps
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
          sample_block(pixels, block->first, block->n, kernel, block->samples);
          for (std::size_t d = 0; d < block->samples.n_doubtful; ++d) {
            const std::size_t at = block->samples.doubtful[d];
            resolve(view, pixels, block->first + block->samples.group[at / SampleBlock::width] + at % SampleBlock::width, block->samples.sample[at]);
          }
          find_slots(*block);
          return block;
        });
    for (std::size_t c = 0; c < per_pixel; ++c) {
      const std::size_t channel = per_pixel > 1 ? c : static_cast<std::size_t>(pixels.channel);
      // Summed radiance over summed irradiance: w f = radiance * scale, without the irradiance that w is relative to.
      const auto i = static_cast<int>(channel);
      const double scale = 1 / (calibration_.dn_per_radiance[i] * view.light.intensity[i] * view.reference);
      chain = chain & tbb::make_filter<Block*, Block*>(tbb::filter_mode::serial_in_order,
                                                       [=, &image, &pixels, &accumulator, &found = counts[part][c]](Block* block) {
                        add_block(*block, {image, pixels, per_pixel, c, static_cast<float>(scale), channel}, c == 0, accumulator, found);
                        return block;
                      });
    }
    tbb::parallel_pipeline(in_flight, chain & tbb::make_filter<Block*, void>(tbb::filter_mode::parallel, [](Block*) {}));
  }, tbb::simple_partitioner());
  SampleCounts sum;
  for (const auto& part : counts)
    for (const SampleCounts& found : part) sum += found;
  sum.masked = n_masked_ * per_pixel;
  return sum;
}

}  // namespace lacquer::calib
