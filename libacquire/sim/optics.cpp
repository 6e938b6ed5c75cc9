#include "libacquire/sim/optics.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <span>

namespace lacquer::acquire::sim {

namespace {

template <typename Body>
void parallel(int n, const Body& body) {
  tbb::parallel_for(tbb::blocked_range<int>(0, n, 8), [&](const tbb::blocked_range<int>& range) {
    for (int i = range.begin(); i != range.end(); ++i) body(i);
  });
}

std::size_t size(int n) { return static_cast<std::size_t>(n); }

/// `row` extended by `n` copies of its ends on both sides.
std::vector<float> padded(std::span<const float> row, std::size_t n) {
  std::vector<float> wide(row.size() + 2 * n);
  std::fill_n(wide.begin(), n, row.front());
  std::copy(row.begin(), row.end(), wide.begin() + static_cast<std::ptrdiff_t>(n));
  std::fill_n(wide.end() - static_cast<std::ptrdiff_t>(n), n, row.back());
  return wide;
}

void blur_row(std::span<float> row, const std::vector<float>& kernel) {
  const std::size_t reach = kernel.size() - 1;
  const std::vector<float> wide = padded(row, reach);
  for (std::size_t x = 0; x < row.size(); ++x) row[x] = kernel[0] * wide[x + reach];
  for (std::size_t k = 1; k <= reach; ++k)
    for (std::size_t x = 0; x < row.size(); ++x) row[x] += kernel[k] * (wide[x + reach - k] + wide[x + reach + k]);
}

/// Rows are added as a whole, so that the inner loop runs along the memory.
void blur_columns(std::span<float> plane, int width, int height, const std::vector<float>& kernel) {
  const std::vector<float> source(plane.begin(), plane.end());
  const int reach = static_cast<int>(kernel.size()) - 1;
  const auto source_row = [&](int y) { return source.data() + size(std::clamp(y, 0, height - 1)) * size(width); };
  parallel(height, [&](int y) {
    float* row = plane.data() + size(y) * size(width);
    const float* centre = source_row(y);
    for (int x = 0; x < width; ++x) row[x] = kernel[0] * centre[x];
    for (int k = 1; k <= reach; ++k) {
      const float weight = kernel[size(k)];
      const float *above = source_row(y - k), *below = source_row(y + k);
      for (int x = 0; x < width; ++x) row[x] += weight * (above[x] + below[x]);
    }
  });
}

std::span<float> plane_of(RadianceImage& image, int channel) {
  return std::span<float>(image.data).subspan(image.index(channel, 0, 0), size(image.width) * size(image.height));
}

}  // namespace

std::vector<float> discrete_gaussian(double sigma) {
  const double t = sigma * sigma;
  std::vector<double> weights{std::exp(-t) * std::cyl_bessel_i(0.0, t)};
  double total = weights[0];
  for (int n = 1; 1 - total > 1e-7 && n < 200; ++n) {
    weights.push_back(std::exp(-t) * std::cyl_bessel_i(static_cast<double>(n), t));
    total += 2 * weights.back();
  }
  std::vector<float> kernel;
  for (const double w : weights) kernel.push_back(static_cast<float>(w / total));
  return kernel;
}

void blur(RadianceImage& image, double sigma) {
  if (!(sigma > 0)) return;
  const std::vector<float> kernel = discrete_gaussian(sigma);
  for (int channel = 0; channel < image.n_channels; ++channel) {
    const std::span<float> plane = plane_of(image, channel);
    parallel(image.height, [&](int y) { blur_row(plane.subspan(size(y) * size(image.width), size(image.width)), kernel); });
    blur_columns(plane, image.width, image.height, kernel);
  }
}

void add_stray_light(RadianceImage& image, double fraction) {
  if (fraction == 0) return;
  for (int channel = 0; channel < image.n_channels; ++channel) {
    const std::span<float> plane = plane_of(image, channel);
    double total = 0;
    for (const float v : plane) total += static_cast<double>(v);
    const float glare = static_cast<float>(fraction * total / static_cast<double>(plane.size()));
    for (float& v : plane) v += glare;
  }
}

void vignette(RadianceImage& image, const CameraModel& camera, double vignetting) {
  if (vignetting == 0) return;
  const double corner_x = std::max(camera.centre.x + 0.5, camera.width - 0.5 - camera.centre.x);
  const double corner_y = std::max(camera.centre.y + 0.5, camera.height - 0.5 - camera.centre.y);
  const double loss = vignetting / (corner_x * corner_x + corner_y * corner_y);
  parallel(image.height, [&](int y) {
    const double dy = y - camera.centre.y;
    for (int x = 0; x < image.width; ++x) {
      const double dx = x - camera.centre.x;
      const float transmission = static_cast<float>(1 - loss * (dx * dx + dy * dy));
      for (int channel = 0; channel < image.n_channels; ++channel) image.at(channel, x, y) *= transmission;
    }
  });
}

}  // namespace lacquer::acquire::sim
