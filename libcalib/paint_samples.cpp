#include "libcalib/paint_samples.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <optional>

#include "libcalib/samples.h"

namespace lacquer::calib {

namespace {

/// By channel, of the values in a rectangle, noise and clipped ones included; 0 without any.
std::array<double, 3> means_of(const RadianceImage& image, int x0, int y0, int width, int height) {
  const int per_pixel = acquire::values_per_pixel(image.layout);
  std::array<double, 3> sum{}, n{};
  for (int y = y0; y < y0 + height; ++y)
    for (int x = x0; x < x0 + width; ++x)
      for (int k = 0; k < per_pixel; ++k) {
        const auto i = static_cast<std::size_t>((static_cast<std::ptrdiff_t>(y) * image.width + x) * per_pixel + k);
        if (image.flags[i] == PixelFlag::invalid) continue;
        const auto c = static_cast<std::size_t>(acquire::channel_of(image.layout, x, y, k));
        sum[c] += image.radiance[i];
        ++n[c];
      }
  for (std::size_t c = 0; c < 3; ++c) sum[c] = n[c] > 0 ? sum[c] / n[c] : 0;
  return sum;
}

/// How the values of a block enter its mean.
struct BlockWeights {
  std::vector<double> of;         ///< by row, column and value of the pixel; sum 1
  std::array<double, 3> share{};  ///< of the channels
  double moment = 0, skew = 0;    ///< as in PaintSample

  /// Each colour's weights are linear in the place, so that its mean place is the block's middle: a step of half a pixel between colours would be a step of
  /// the light where their slopes differ. Colours share by the inverse variance that leaves them, were the noise of all values the same; one whose pixels lie on a
  /// line or a point beside the middle has no share.
  BlockWeights(acquire::PixelLayout layout, int block) : of(static_cast<std::size_t>(block * block * acquire::values_per_pixel(layout))) {
    const int per_pixel = acquire::values_per_pixel(layout);
    const double middle = 0.5 * (block - 1);
    std::array<double, 3> n{}, x_sum{}, y_sum{}, xx{}, yy{}, squares{};
    const auto each = [&](const auto& body) {
      std::size_t i = 0;
      for (int y = 0; y < block; ++y)
        for (int x = 0; x < block; ++x)
          for (int k = 0; k < per_pixel; ++k, ++i) body(i, static_cast<std::size_t>(acquire::channel_of(layout, x, y, k)), x - middle, y - middle);
    };
    each([&](std::size_t, std::size_t c, double x, double y) {
      ++n[c];
      x_sum[c] += x;
      y_sum[c] += y;
    });
    each([&](std::size_t, std::size_t c, double x, double y) {
      xx[c] += std::pow(x - x_sum[c] / n[c], 2) / n[c];
      yy[c] += std::pow(y - y_sum[c] / n[c], 2) / n[c];
    });
    each([&](std::size_t i, std::size_t c, double x, double y) {
      const double mx = x_sum[c] / n[c], my = y_sum[c] / n[c];
      if ((mx != 0 && xx[c] == 0) || (my != 0 && yy[c] == 0)) return;
      of[i] = (1 - (mx != 0 ? mx * (x - mx) / xx[c] : 0) - (my != 0 ? my * (y - my) / yy[c] : 0)) / n[c];
      squares[c] += of[i] * of[i];
    });
    double all = 0;
    for (std::size_t c = 0; c < 3; ++c) all += squares[c] > 0 ? 1 / squares[c] : 0;
    for (std::size_t c = 0; c < 3; ++c) share[c] = squares[c] > 0 ? 1 / squares[c] / all : 0;
    const double variance = PaintBlocks{block, block}.variance();
    each([&](std::size_t i, std::size_t c, double x, double y) {
      of[i] *= share[c];
      moment += of[i] * (x * x + y * y) / 2 / variance;
      skew += of[i] * x * y / variance;
    });
  }
};

/// Of the channels' means over the image; nullopt: it is not brighter than its noise.
std::optional<double> log_mean_of(const RadianceImage& image, const std::array<double, 3>& share) {
  const std::array<double, 3> means = means_of(image, 0, 0, image.width, image.height);
  double sum = 0;
  for (std::size_t c = 0; c < 3; ++c) {
    if (!(share[c] > 0)) continue;
    if (!(means[c] > 0)) return std::nullopt;
    sum += share[c] * std::log(means[c]);
  }
  return sum;
}

}  // namespace

void BackgroundShare::add(const RadianceImage& image) {
  constexpr int part = 10;  // of the image's side
  const std::size_t c = image.layout == acquire::PixelLayout::mono ? 0 : 1;
  const int width = std::max(1, image.width / part), height = std::max(1, image.height / part);
  for (std::size_t k = 0; k < corner_.size(); ++k)
    corner_[k] += means_of(image, k % 2 == 0 ? 0 : image.width - width, k < 2 ? 0 : image.height - height, width, height)[c];
  whole_ += means_of(image, 0, 0, image.width, image.height)[c];
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
  const double corner2 = std::pow(std::max(g.camera.centre.x + 0.5, g.camera.width - 0.5 - g.camera.centre.x), 2) +
                         std::pow(std::max(g.camera.centre.y + 0.5, g.camera.height - 0.5 - g.camera.centre.y), 2);
  const int block = blocks.block;
  const BlockWeights weights(image.layout, block);
  const std::optional<double> log_mean = log_mean_of(image, weights.share);
  if (!log_mean) return;
  // Another part of the grid in each view.
  const int first = 2 * (static_cast<int>(view) * 7 % std::max(1, blocks.stride / 2));
  for (int row = first; row + block <= image.height; row += blocks.stride)
    for (int column = (first * 3) % blocks.stride; column + block <= image.width; column += blocks.stride) {
      const glm::dvec2 middle = glm::dvec2(column, row) + 0.5 * (block - 1);
      const auto point = acquire::trace(g, middle);
      if (!point || glm::dot(point->normal, point->wo) < 0.2) continue;
      double sum = 0, variance = 0;
      bool whole = true;
      const double* weight = weights.of.data();
      for (int y = row; y < row + block && whole; ++y)
        for (int x = column; x < column + block && whole; ++x)
          for (int k = 0; k < per_pixel; ++k, ++weight) {
            if (*weight == 0) continue;
            const auto i = static_cast<std::size_t>((static_cast<std::ptrdiff_t>(y) * image.width + x) * per_pixel + k);
            const double value = image.radiance[i], relative = image.variance[i] / (value * value);
            // A block without its darkest or its brightest values is not its mean, nor is one whose colours have other shares.
            if (image.flags[i] != PixelFlag::valid || !(value > 0) || !(relative < noisy * noisy)) {
              whole = false;
              break;
            }
            sum += *weight * (std::log(value / lens_transmission(calibration, {x, y})) + relative / 2);  // of the mean, not the mean of logarithms
            variance += *weight * *weight * relative;
          }
      if (!whole) continue;
      const double reach = std::sqrt(blocks.variance());
      const auto ray = g.camera.unproject(middle), right = g.camera.unproject(middle + glm::dvec2(reach, 0)), below = g.camera.unproject(middle + glm::dvec2(0, reach));
      if (!ray || !right || !below) continue;
      const glm::dvec2 offset = middle - g.camera.centre;
      PaintSample s;
      s.view = view;
      s.tile = static_cast<std::uint32_t>(row) * paint_tiles_across / static_cast<std::uint32_t>(image.height) * paint_tiles_across +
               static_cast<std::uint32_t>(column) * paint_tiles_across / static_cast<std::uint32_t>(image.width);
      s.sight = ray->direction;
      s.spread = {right->direction - ray->direction, below->direction - ray->direction};
      s.moment = weights.moment;
      s.skew = weights.skew;
      s.variance = variance;
      s.log_radiance = sum;
      s.log_mean = *log_mean;
      s.corner2 = glm::dot(offset, offset) / corner2;
      samples.push_back(s);
    }
}

}  // namespace lacquer::calib
