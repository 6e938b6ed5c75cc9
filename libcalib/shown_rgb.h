#pragma once

#include <glm/vec3.hpp>
#include <vector>

#include "libcalib/radiance_image.h"

namespace lacquer::calib {

/// A photograph to be looked at, never measured from: one colour per pixel, a mosaic at half size (one 2 x 2 block = one pixel).
struct ShownRgb {
  int step = 1;  ///< pixels of the photograph per pixel of the picture
  int width = 0, height = 0;
  std::vector<glm::vec3> rgb;  ///< linear, divided by the white balance; black where not complete
  std::vector<bool> complete;  ///< every value of the pixel is used: half a block would show as a coloured fringe
};

/// `values`, `used`: as the radiance of `shape`.
ShownRgb shown_rgb(const std::vector<float>& values, const std::vector<bool>& used, const RadianceImage& shape, const glm::dvec3& white_balance);

}  // namespace lacquer::calib
