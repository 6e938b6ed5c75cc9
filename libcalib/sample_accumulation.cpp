#include <tbb/parallel_pipeline.h>

#include <algorithm>
#include <array>
#include <glm/geometric.hpp>

#include "libcalib/samples.h"

namespace lacquer::calib {

KernelView Sampler::kernel_view(const View& view) const {
  const double radius = calibration_.geometry.sphere_radius;
  return {.sphere_radius = static_cast<float>(radius),
          .central = central(),
          .camera = camera_,
          .distant = view.light.distant,
          .light = view.light.distant ? view.light.direction : view.light.position,
          .surface = view.light.distant ? 0 : radius,
          .light_distance2 = static_cast<float>(glm::dot(view.light.position, view.light.position) - radius * radius),
          .axis = view.light.axis,
          .falloff_exponent = static_cast<float>(view.light.falloff_exponent),
          .diameter = static_cast<float>(view.light.diameter),
          .blur2 = static_cast<float>(view.blur2),
          .min_cosine = static_cast<float>(view.min_cosine),
          .narrowest_m = static_cast<float>(options_.narrowest_m),
          .reference = static_cast<float>(view.reference)};
}

/// A block of pixels on its way from the threads that compute to the one that adds.
struct Sampler::Block {
  std::size_t first, n;  // pixels
  SampleBlock samples;
  std::uint32_t slot[SampleBlock::size];
  /// Per channel of the pixel: weight times f_r, weight^2 times its variance.
  float value[3][SampleBlock::size], variance[3][SampleBlock::size];
  PixelFlag flag[3][SampleBlock::size];
};

/// What float could not decide, by the scalar code.
void Sampler::resolve(const View& view, std::size_t pixel, std::size_t k, SampleBlock& block) const {
  const Lit lit = light(view, pixel);
  block.fate[k] = lit.fate;
  if (lit.fate != SampleBlock::used) return;
  using Grid = brdf::TableGrid;
  const Grid::Cell cell = Grid::cell(lit.coordinates);
  const brdf::HalfDiff centre = Grid::centre(cell);
  const auto weighted = [&](double x) { return static_cast<float>(lit.weight * x); };
  block.weight[k] = static_cast<float>(lit.weight);
  block.theta_h[k] = weighted(lit.coordinates.theta_h - centre.theta_h);
  block.theta_d[k] = weighted(lit.coordinates.theta_d - centre.theta_d);
  block.phi_d[k] = weighted(brdf::fold_phi_d(lit.coordinates.phi_d) - centre.phi_d);
  block.along[k] = weighted(lit.footprint.along);
  block.across[k] = weighted(lit.footprint.across);
  block.mixed[k] = weighted(lit.footprint.mixed);
  block.row[k] = cell.theta_h * Grid::n_theta_d + cell.theta_d;
  block.cell_phi_d[k] = cell.phi_d;
}

void Sampler::fill(const View& view, const KernelView& kernel, const RadianceImage& image, Block& block) const {
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(layout_));
  const brdf::ReachableCells& cells = brdf::reachable_cells();
  // Summed radiance over summed irradiance: w f = radiance * scale, without the irradiance that w is relative to.
  std::array<float, 3> scale;
  for (int c = 0; c < 3; ++c)
    scale[static_cast<std::size_t>(c)] = static_cast<float>(1 / (calibration_.dn_per_radiance[c] * view.light.intensity[c] * view.reference));
  sample_block(pixels_, block.first, block.n, kernel, block.samples);
  for (std::size_t k = 0; k < block.n; ++k) {
    const std::size_t pixel = block.first + k;
    if (block.samples.fate[k] == SampleBlock::doubtful) resolve(view, pixel, k, block.samples);
    if (block.samples.fate[k] != SampleBlock::used) continue;
    block.samples.along[k] += cells.squared_slope(block.samples.row[k] / brdf::TableGrid::n_theta_d) * block.samples.theta_h[k] * block.samples.theta_h[k] / block.samples.weight[k];
    block.slot[k] = cells.slot(block.samples.row[k], block.samples.cell_phi_d[k]);
    for (std::size_t c = 0; c < per_pixel; ++c) {
      const std::size_t value = pixels_.index[pixel] * per_pixel + c;
      const float factor = scale[per_pixel > 1 ? c : pixels_.channel[pixel]] * pixels_.inverse_transmission[pixel];
      block.value[c][k] = image.radiance[value] * factor;
      block.variance[c][k] = image.variance[value] * (factor * factor);
      block.flag[c][k] = image.flags[value];
    }
  }
}

namespace {

/// Adds a block in the order of its pixels.
template <typename Block>
void add_block(const Block& block, const SpherePixels& pixels, std::size_t per_pixel, brdf::TableAccumulator& accumulator, SampleCounts& counts) {
  constexpr std::size_t ahead = 8;  // samples: the cells lie all over the memory
  const SampleBlock& samples = block.samples;
  const auto channel_of = [&](std::size_t k, std::size_t c) { return per_pixel > 1 ? c : std::size_t{pixels.channel[block.first + k]}; };
  for (std::size_t k = 0; k < block.n; ++k) {
    const std::size_t next = k + ahead;
    if (next < block.n && samples.fate[next] == SampleBlock::used)
      for (std::size_t c = 0; c < per_pixel; ++c) accumulator.prefetch(channel_of(next, c), block.slot[next]);
    if (samples.fate[k] != SampleBlock::used) {
      (samples.fate[k] == SampleBlock::blurred ? counts.blurred : counts.grazing) += per_pixel;
      continue;
    }
    brdf::CellSums s;
    s.weight = samples.weight[k];
    s.theta_h = samples.theta_h[k];
    s.theta_d = samples.theta_d[k];
    s.phi_d = samples.phi_d[k];
    s.along = samples.along[k];
    s.across = samples.across[k];
    s.mixed = samples.mixed[k];
    s.count = 1;
    for (std::size_t c = 0; c < per_pixel; ++c) {
      const PixelFlag flag = block.flag[c][k];
      ++(flag == PixelFlag::clipped ? counts.clipped : flag == PixelFlag::invalid ? counts.invalid : counts.used);
      if (flag == PixelFlag::invalid) continue;
      s.value = block.value[c][k];
      s.variance = block.variance[c][k];
      s.bounds = flag == PixelFlag::clipped;
      accumulator.add(channel_of(k, c), block.slot[k], s);
    }
  }
}

}  // namespace

SampleCounts Sampler::accumulate_view(const RadianceImage& image, const Illumination& lighting, brdf::TableAccumulator& accumulator) const {
  check(image);
  const View view = view_of(lighting);
  const KernelView kernel = kernel_view(view);
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(layout_));
  SampleCounts counts;
  counts.masked = n_masked_ * per_pixel;

  constexpr std::size_t in_flight = 16;  // blocks of about 40 KB: they stay in the cache between the two steps
  std::vector<Block> blocks(in_flight);
  std::size_t first = 0, next = 0;
  tbb::parallel_pipeline(
      in_flight, tbb::make_filter<void, Block*>(tbb::filter_mode::serial_in_order, [&](tbb::flow_control& control) -> Block* {
        if (first >= pixels_.size) {
          control.stop();
          return nullptr;
        }
        Block* block = &blocks[next++ % in_flight];
        block->first = first;
        block->n = std::min(SampleBlock::size, pixels_.size - first);
        first += block->n;
        return block;
      }) & tbb::make_filter<Block*, Block*>(tbb::filter_mode::parallel, [&](Block* block) {
        fill(view, kernel, image, *block);
        return block;
      }) & tbb::make_filter<Block*, void>(tbb::filter_mode::serial_in_order, [&](const Block* block) {
        add_block(*block, pixels_, per_pixel, accumulator, counts);
      }));
  return counts;
}

}  // namespace lacquer::calib
