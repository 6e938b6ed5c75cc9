#include "libacquire/mask_circle.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "libacquire/frame.h"
#include "libbrdf/error.h"

namespace lacquer::acquire {

ImageCircle circle_of_mask(const std::filesystem::path& file, int width, int height) {
  const RawFrame mask = read_frame(file.string(), 8, PixelLayout::mono);
  if (mask.width != width || mask.height != height)
    throw Error(ErrorCode::file, fmt::format("{}: mask of {} x {} pixels; expected {} x {} as the camera", file.string(), mask.width,
                                             mask.height, width, height));
  const int n_values = values_per_pixel(mask.layout);
  double area = 0, sum_x = 0, sum_y = 0;
  int left = width, right = -1, top = height, bottom = -1;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const auto* pixel = &mask.data[(static_cast<std::size_t>(y) * width + x) * n_values];
      if (std::all_of(pixel, pixel + n_values, [](std::uint16_t v) { return v == 0; })) continue;
      area += 1;
      sum_x += x;
      sum_y += y;
      left = std::min(left, x);
      right = std::max(right, x);
      top = std::min(top, y);
      bottom = std::max(bottom, y);
    }
  }
  if (area == 0) throw Error(ErrorCode::file, file.string() + ": mask is empty; expected the disc of the sphere");
  const double radius = std::sqrt(area / 3.14159265358979323846);
  // A disc of radius r is 2 r wide and high; 2 % and 2 pixels leave room for the ellipse of a perspective view and for ragged edges.
  const double tolerance = 2 + 0.02 * 2 * radius;
  if (std::abs(right - left + 1 - 2 * radius) > tolerance || std::abs(bottom - top + 1 - 2 * radius) > tolerance)
    throw Error(ErrorCode::file, fmt::format("{}: mask is {} x {} pixels wide and high with the area of a disc of {:.1f} pixels, not a full "
                                             "disc; state sphere.centre_px and sphere.radius_px", file.string(), right - left + 1,
                                             bottom - top + 1, 2 * radius));
  return {{sum_x / area, sum_y / area}, radius};
}

}  // namespace lacquer::acquire
