#pragma once

#include <filesystem>
#include <glm/vec2.hpp>

namespace lacquer::acquire {

/// A sphere's outline in the image: pixels, (0, 0) is the centre of the first pixel.
struct ImageCircle {
  glm::dvec2 centre{0.0};
  double radius = 0;
};

/// Circle of a mask that shows the whole sphere (8-bit image, 0 = not paint, any other value = paint): centroid and radius of the circle
/// of equal area. Both average over the whole boundary: for a disc of 70 px the error is some 0.01 px.
/// Throws Error{file}: not readable, other size than expected, or not a full disc.
ImageCircle circle_of_mask(const std::filesystem::path& file, int width, int height);

}  // namespace lacquer::acquire
