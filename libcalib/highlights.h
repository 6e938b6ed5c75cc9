#pragma once

#include <optional>
#include <string>

#include "libcalib/calibration.h"
#include "libcalib/geometry_solver.h"
#include "libcalib/radiance_image.h"

namespace lacquer::calib {

struct HighlightOptions {
  double search_rad = 0.05;     ///< the normal at the peak may differ this much from where the given geometry has it
  double min_cosine = 0.25;     ///< of normal and line of sight: beyond it the silhouette cuts the highlight
  double max_width_rad = 0.12;  ///< 1/e radius of the peak as a slope of the half vector; wider ones are gloss without a clear coat
  double min_contrast = 0.5;    ///< height of the peak over what lies under it
};

/// Why a view gives no highlight.
enum class HighlightFate { found, hidden, silhouette, border, clipped, matte, two_peaks, poor };
/// In words, for a count: "hidden behind the sphere", ...
std::string describe(HighlightFate fate);

struct HighlightResult {
  HighlightFate fate = HighlightFate::hidden;
  Highlight highlight;   ///< if found; view, light and angle are the caller's
  double width_rad = 0;  ///< 1/e radius, slope of the half vector
  double contrast = 0;
  double asymmetry = 0;  ///< by how much the centre moves when the flanks are left out, sigmas of the lobe
  double elongation = 0; ///< by which it is longer than a lobe, share of its variance
  double left_out = 0;   ///< share of the lobe that the fit does not believe
};

/// Mirror peak of one near light. The peak's shape is known in half vectors, not in pixels: an isotropic lobe is symmetric about the
/// normal. So irradiance and 1/(n.o) are divided out and a lobe that is symmetric in the slope of the half vector is fitted, shifted as
/// a whole, over a window symmetric about it: a lobe of any profile gives its centre without bias. `calibration.geometry` must have the
/// sphere where it is, the light roughly; fit again with the solved geometry where the shift was more than a few pixels. The mosaic's
/// colours are fitted with a height each; nothing is interpolated. The covariance comes from the residuals where they exceed the noise.
/// `corner`: pixel of the camera at which `image` begins.
HighlightResult find_highlight(const RadianceImage& image, const Calibration& calibration, std::size_t light, double turntable_angle,
                               const HighlightOptions& options, const glm::ivec2& corner = glm::ivec2(0));

}  // namespace lacquer::calib
