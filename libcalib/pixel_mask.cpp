#include "libcalib/pixel_mask.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <opencv2/imgcodecs.hpp>

#include "libbrdf/error.h"

namespace lacquer::calib {

std::vector<std::uint8_t> paint_mask(const acquire::MaskDescription& mask, const acquire::RigGeometry& geometry) {
  const int width = geometry.camera.width, height = geometry.camera.height;
  std::vector<std::uint8_t> paint(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), 1);
  if (mask.file) {
    const cv::Mat image = cv::imread(mask.file->string(), cv::IMREAD_GRAYSCALE);
    if (image.empty()) throw Error(ErrorCode::file, fmt::format("{}: mask: cannot be read as an image", mask.file->string()));
    if (image.cols != width || image.rows != height)
      throw Error(ErrorCode::file, fmt::format("{}: mask: expected {}x{} pixels as the camera has, got {}x{}", mask.file->string(), width, height, image.cols, image.rows));
    for (int y = 0; y < height; ++y) std::copy_n(image.ptr<std::uint8_t>(y), width, paint.begin() + static_cast<std::ptrdiff_t>(y) * width);
  }
  if (!mask.min_y) return paint;
  tbb::parallel_for(0, height, [&](int y) {
    for (int x = 0; x < width; ++x) {
      const auto point = acquire::trace(geometry, {x, y});
      if (point && point->position.y < *mask.min_y) paint[static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x)] = 0;
    }
  });
  return paint;
}

void apply_mask(const std::vector<std::uint8_t>& mask, RadianceImage& image) {
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(image.layout));
  for (std::size_t i = 0; i < mask.size(); ++i)
    for (std::size_t k = 0; mask[i] == 0 && k < per_pixel; ++k) image.flags[i * per_pixel + k] = PixelFlag::invalid;
}

}  // namespace lacquer::calib
