#include "libcalib/shown_rgb.h"

namespace lacquer::calib {

ShownRgb shown_rgb(const std::vector<float>& values, const std::vector<bool>& used, const RadianceImage& shape, const glm::dvec3& white_balance) {
  const bool mosaic = acquire::n_channels(shape.layout) == 3 && acquire::values_per_pixel(shape.layout) == 1;
  const int step = mosaic ? 2 : 1, per_pixel = acquire::values_per_pixel(shape.layout);
  ShownRgb shown{step, shape.width / step, shape.height / step, {}, {}};
  const std::size_t n = static_cast<std::size_t>(shown.width) * static_cast<std::size_t>(shown.height);
  shown.rgb.assign(n, glm::vec3(0.0f));
  shown.complete.assign(n, false);
  for (int y = 0; y < shown.height; ++y)
    for (int x = 0; x < shown.width; ++x) {
      glm::vec3 sum(0.0f), count(0.0f);
      bool complete = true;
      for (int dy = 0; dy < step; ++dy)
        for (int dx = 0; dx < step; ++dx)
          for (int k = 0; k < per_pixel; ++k) {
            const int channel = acquire::channel_of(shape.layout, x * step + dx, y * step + dy, k);
            const auto i = (static_cast<std::size_t>(y * step + dy) * static_cast<std::size_t>(shape.width) + static_cast<std::size_t>(x * step + dx)) *
                               static_cast<std::size_t>(per_pixel) +
                           static_cast<std::size_t>(k);
            complete = complete && used[i];
            sum[channel] += values[i];
            count[channel] += 1;
          }
      if (!complete) continue;
      const std::size_t i = static_cast<std::size_t>(y) * static_cast<std::size_t>(shown.width) + static_cast<std::size_t>(x);
      shown.complete[i] = true;
      for (int c = 0; c < 3; ++c)
        if (count[c] > 0) shown.rgb[i][c] = static_cast<float>(sum[c] / count[c] / white_balance[c]);
      if (acquire::n_channels(shape.layout) == 1) shown.rgb[i] = glm::vec3(shown.rgb[i].x);
    }
  return shown;
}

}  // namespace lacquer::calib
