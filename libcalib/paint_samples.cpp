#include "libcalib/paint_samples.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

#include "libcalib/samples.h"

namespace lacquer::calib {

namespace {

/// Of the green or only values in a rectangle, noise and clipped ones included.
double mean_of(const RadianceImage& image, int x0, int y0, int width, int height) {
  const int per_pixel = acquire::values_per_pixel(image.layout), k = per_pixel > 1 ? 1 : 0;
  const bool colour = image.layout != acquire::PixelLayout::mono;
  double sum = 0, n = 0;
  for (int y = y0; y < y0 + height; ++y)
    for (int x = x0; x < x0 + width; ++x) {
      const auto i = static_cast<std::size_t>((static_cast<std::ptrdiff_t>(y) * image.width + x) * per_pixel + k);
      if ((colour && acquire::channel_of(image.layout, x, y, k) != 1) || image.flags[i] == PixelFlag::invalid) continue;
      sum += image.radiance[i];
      ++n;
    }
  return n > 0 ? sum / n : 0;
}

}  // namespace

void BackgroundShare::add(const RadianceImage& image) {
  constexpr int part = 10;  // of the image's side
  const int width = std::max(1, image.width / part), height = std::max(1, image.height / part);
  for (std::size_t c = 0; c < corner_.size(); ++c)
    corner_[c] += mean_of(image, c % 2 == 0 ? 0 : image.width - width, c < 2 ? 0 : image.height - height, width, height);
  whole_ += mean_of(image, 0, 0, image.width, image.height);
}

double BackgroundShare::value() const {
  return whole_ > 0 ? std::clamp(*std::min_element(corner_.begin(), corner_.end()) / whole_, 0.0, 1.0) : 1.0;
}

PaintBlocks paint_blocks(const acquire::RigGeometry& g, std::size_t n_views) {
  constexpr double wanted = 200000, usable = 0.4, per_radius = 54;
  const double radius = g.camera.focal.x * g.sphere_radius / g.cam_from_rig.translation.z;
  PaintBlocks b;
  b.block = 2 * std::max(1, static_cast<int>(std::lround(radius / per_radius / 2)));
  const double apart = std::sqrt(3.14159265358979323846 * radius * radius * usable * static_cast<double>(n_views) / wanted);
  b.stride = std::max(b.block, 2 * static_cast<int>(std::lround(apart / 2)));
  return b;
}

void add_paint_samples(const RadianceImage& image, const Calibration& calibration, std::uint32_t view, const PaintBlocks& blocks, std::vector<PaintSample>& samples) {
  constexpr double noisy = 0.05;  // relative: beyond it the logarithm of a mean is no longer the mean of the logarithm
  const acquire::RigGeometry& g = calibration.geometry;
  const int per_pixel = acquire::values_per_pixel(image.layout);
  const bool colour = image.layout != acquire::PixelLayout::mono;
  const double corner2 = std::pow(std::max(g.camera.centre.x + 0.5, g.camera.width - 0.5 - g.camera.centre.x), 2) +
                         std::pow(std::max(g.camera.centre.y + 0.5, g.camera.height - 0.5 - g.camera.centre.y), 2);
  const double mean = mean_of(image, 0, 0, image.width, image.height);
  if (!(mean > 0)) return;  // no light on it that exceeds the noise
  const double log_mean = std::log(mean);
  const int block = blocks.block;
  // Another part of the grid in each view.
  const int first = 2 * (static_cast<int>(view) * 7 % std::max(1, blocks.stride / 2));
  for (int row = first; row + block <= image.height; row += blocks.stride)
    for (int column = (first * 3) % blocks.stride; column + block <= image.width; column += blocks.stride) {
      const glm::dvec2 middle = glm::dvec2(column, row) + 0.5 * (block - 1);
      const auto point = acquire::trace(g, middle);
      if (!point || glm::dot(point->normal, point->wo) < 0.2) continue;
      glm::dvec2 place(0.0);
      double n = 0, sum = 0, variances = 0, xy = 0;
      bool whole = true;
      for (int y = row; y < row + block && whole; ++y)
        for (int x = column; x < column + block; ++x) {
          const int k = per_pixel > 1 ? 1 : 0;
          if (colour && acquire::channel_of(image.layout, x, y, k) != 1) continue;
          const auto i = static_cast<std::size_t>((static_cast<std::ptrdiff_t>(y) * image.width + x) * per_pixel + k);
          const double value = image.radiance[i], relative = image.variance[i] / (value * value);
          if (image.flags[i] == PixelFlag::invalid) continue;
          // A block without its darkest or its brightest values is not its mean.
          if (image.flags[i] != PixelFlag::valid || !(value > 0) || !(relative < noisy * noisy)) {
            whole = false;
            break;
          }
          place += glm::dvec2(x, y);
          xy += (x - middle.x) * (y - middle.y);
          sum += std::log(value / lens_transmission(calibration, {x, y})) + relative / 2;  // of the mean, not the mean of logarithms
          variances += relative;
          ++n;
        }
      if (!whole || 2 * n < block * block * (colour && per_pixel == 1 ? 0.5 : 1.0)) continue;  // half of them at least
      place /= n;
      const double reach = std::sqrt(blocks.variance());
      const auto ray = g.camera.unproject(place), right = g.camera.unproject(place + glm::dvec2(reach, 0)), below = g.camera.unproject(place + glm::dvec2(0, reach));
      if (!ray || !right || !below) continue;
      const glm::dvec2 offset = middle - g.camera.centre;
      PaintSample s;
      s.view = view;
      s.tile = static_cast<std::uint32_t>(row) * paint_tiles_across / static_cast<std::uint32_t>(image.height) * paint_tiles_across +
               static_cast<std::uint32_t>(column) * paint_tiles_across / static_cast<std::uint32_t>(image.width);
      s.sight = ray->direction;
      s.spread = {right->direction - ray->direction, below->direction - ray->direction};
      s.skew = (xy / n - (place.x - middle.x) * (place.y - middle.y)) / blocks.variance();
      s.variance = variances / (n * n);
      s.log_radiance = sum / n;
      s.log_mean = log_mean;
      s.corner2 = glm::dot(offset, offset) / corner2;
      samples.push_back(s);
    }
}

}  // namespace lacquer::calib
