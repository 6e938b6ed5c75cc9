#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <vector>

#include "libacquire/frame.h"
#include "libacquire/rig_geometry.h"
#include "libcalib/calibration.h"
#include "libcalib/geometry_unknowns.h"
#include "libcalib/geometry_solver.h"
#include "libcalib/radiance_image.h"

/// What the light on the paint says of the geometry: the same half and difference angles occur at many places of the sphere and in many
/// views, and wherever they do the paint is the same. docs/geometry.md has the equations.
namespace lacquer::calib {

/// Mean of some pixels of a view. Only green values of a mosaic are used: the paint is needed for one colour only.
struct PaintSample {
  std::uint32_t view = 0;
  std::uint32_t tile = 0;      ///< of the image: samples of a tile and view share errors
  glm::dvec3 sight{0, 0, 1};   ///< line of sight in the camera frame, unit
  std::array<glm::dvec3, 2> spread{};  ///< how far the pixels' lines of sight reach from it: RMS in the image's x, in its y
  double log_radiance = 0;     ///< lens' transmission taken out
  double variance = 0;         ///< of log_radiance
  double corner2 = 0;          ///< squared distance from the principal point, of the image's corner's
};

/// How a view of the samples was lit.
struct PaintView {
  std::size_t light = 0;
  double turntable_angle = 0;   ///< radians, read back
  double factor = 1;            ///< on the light's intensity: its drift
};

/// Which pixels become samples: blocks of `block` x `block` pixels, one every `stride` pixels.
struct PaintBlocks {
  int block = 2, stride = 2;
  double variance() const { return (block * block - 1) / 12.0; }  ///< of a pixel's place in its block, pixels^2 per axis
};
/// Blocks of about a degree of the sphere, as many as give some 100 000 samples in all views together.
PaintBlocks paint_blocks(const acquire::RigGeometry& geometry, std::size_t n_views);

/// Means over blocks of pixels, each at the mean place of the values that it has.
void add_paint_samples(const RadianceImage& image, const Calibration& calibration, std::uint32_t view, const PaintBlocks& blocks, std::vector<PaintSample>& samples);

struct PaintOptions {
  double lowest_theta_h = 0.12;  ///< radians: nearer to the peak nothing is used, it is the highlights' matter
  double min_cosine = 0.45;      ///< of light and camera: beyond it shadowing and masking change too fast for the splines
  double aim_rad = 0.0087;       ///< prior of a light's aim, where its intensity falls off the axis
  double falloff = 0.05;         ///< prior of the exponent of that, relative
  double vignetting = 0.005;     ///< prior of what the vignetting in the image's corner is wrong by
  double blur = 0;               ///< variance of lens blur and pixel's area over that of a block's pixels
  double angle_rad = 0;          ///< scatter of the turntable's angles, which all samples of a view share
  double light_scale = 0.1;      ///< prior of each further light's intensity against the first's
  void validate() const;
};

struct PaintEvidence {
  GeometryEvidence geometry;   ///< linear about `x`; empty: too few samples
  std::size_t n_samples = 0;
  double scatter = 0;   ///< of ln f about the paint of the fit, without the noise
};

/// The paint is a PaintSpline that is fitted and eliminated, with the aim and fall-off of the lights and a rest of vignetting. Samples far
/// from the fit count less (Cauchy). The information is what the scatter between tiles of the views supports (sandwich), not what the
/// noise of single pixels would.
PaintEvidence paint_evidence(const std::vector<PaintSample>& samples, const std::vector<PaintView>& views, const GeometryUnknowns& unknowns,
                             const std::vector<double>& x, const PaintOptions& options);

}  // namespace lacquer::calib
