#pragma once

#include <array>
#include <cstdint>
#include <glm/vec3.hpp>
#include <vector>

#include "libcalib/calibration.h"
#include "libcalib/radiance_image.h"

namespace lacquer::calib {

constexpr std::uint32_t paint_tiles_across = 8;  ///< of an image

/// Weighted mean of a block of pixels of a view: of the logarithms of its values, whatever their colour. A geometric mean of the colours' BRDFs is
/// as isotropic, reciprocal and smooth as each of them, and lights of different colours differ in it by factors only.
struct PaintSample {
  std::uint32_t view = 0;
  std::uint32_t tile = 0;      ///< of the image: samples of a tile and view share errors
  glm::dvec3 sight{0, 0, 1};   ///< line of sight in the camera frame, unit
  std::array<glm::dvec3, 2> spread{};  ///< how far the lines of sight of a block's pixels reach from it: RMS in the image's x, in its y
  double moment = 1;           ///< weighted mean square of the pixels' x, and of y, over that of a block's pixels
  double skew = 0;             ///< the same of x times y: colours of a mosaic lie on diagonals
  double log_radiance = 0;     ///< lens' transmission taken out
  double variance = 0;         ///< of log_radiance
  double log_mean = 0;         ///< of the whole image, colours as in log_radiance
  double corner2 = 0;          ///< squared distance from the principal point, of the image's corner's
};

/// Which pixels become samples: blocks of `block` x `block` pixels, one every `stride` pixels.
struct PaintBlocks {
  int block = 2, stride = 2;
  double variance() const { return (block * block - 1) / 12.0; }  ///< of a pixel's place in its block, pixels^2 per axis
};
/// Blocks of about a degree of the sphere, as many as give some 200 000 samples in all views together.
PaintBlocks paint_blocks(const acquire::RigGeometry& geometry, std::size_t n_views);

/// The darkest corner of the images over their mean: stray light, which lies on the whole image, is at most that. Green values of a mosaic.
class BackgroundShare {
 public:
  void add(const RadianceImage& image);
  /// 1: no image yet, or nothing in it.
  double value() const;

 private:
  std::array<double, 4> corner_{};  ///< sums over the images of the corners' means
  double whole_ = 0;                ///< and of the images'
};

/// Means over blocks of pixels all of whose values are good, each at the block's middle.
void add_paint_samples(const RadianceImage& image, const Calibration& calibration, std::uint32_t view, const PaintBlocks& blocks, std::vector<PaintSample>& samples);

}  // namespace lacquer::calib
