#pragma once

#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "libbrdf/brdf.h"
#include "libbrdf/metrics.h"

/// Pictures in colour of all subcommands.
namespace lacquer::tools {

/// Linear sRGB, row-major from the top left; 1 is the display's white.
struct RgbImage {
  int width = 0, height = 0;
  std::vector<glm::vec3> rgb;
  std::vector<bool> covered;  ///< something is to be seen: else drawn in the colour of the ground

  RgbImage() = default;
  RgbImage(int w, int h) : width(w), height(h), rgb(static_cast<std::size_t>(w) * static_cast<std::size_t>(h), glm::vec3(0.0f)), covered(rgb.size(), false) {}
};

RgbImage to_image(const brdf::SphereImage& sphere);

/// PNG (bytes), sRGB-coded, transparent where not covered, enlarged by the whole factor that brings it near to `shown_width`.
std::string png_of(const RgbImage& image, int shown_width = 0);

/// Mean, 95th percentile and map of CIEDE2000 on an ideal sRGB display (values clipped to 0..1) where both images are covered; NaN elsewhere.
struct DeltaE {
  int width = 0, height = 0;
  std::vector<double> map;
  std::size_t n = 0;
  double mean = 0, p95 = 0;
};
DeltaE delta_e(const RgbImage& a, const RgbImage& b);

/// Factor that brings the 99th percentile of the covered values' largest channels to 1; 1 for a black image.
double exposure_for(const RgbImage& image);
RgbImage exposed(RgbImage image, double factor);

}  // namespace lacquer::tools
