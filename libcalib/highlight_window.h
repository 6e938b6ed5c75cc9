#pragma once

#include <cstddef>
#include <glm/mat2x2.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <vector>

#include "libacquire/rig_geometry.h"
#include "libcalib/calibration.h"
#include "libcalib/radiance_image.h"

/// Where a highlight should be and the image's values there, in the coordinates in which a lobe is symmetric. Internal to highlights.cpp.
namespace lacquer::calib {

/// Mirror point of one light as the given geometry has it.
struct ExpectedHighlight {
  acquire::PlacedLight light;
  glm::dvec2 pixel;
  acquire::SurfacePoint point;
  glm::dvec3 u, v;              ///< tangent plane of `point`
  glm::dmat2 slope_per_pixel;   ///< columns: change of the half vector's slope per pixel in x, in y
  glm::dmat2 emitter;           ///< covariance of the slope by the emitter's disc
};

/// One value of the image near the peak, with what is known of its place.
struct HighlightValue {
  glm::dvec2 pixel;
  glm::dvec2 slope;             ///< of the half vector against the normal, in the tangent plane of the expected peak
  double radiance, variance;
  double diffuse, mirror;       ///< factors on body colour and lobe: irradiance, lens, cosines
  std::size_t channel;
  PixelFlag flag;
};

struct HighlightWindow {
  std::vector<HighlightValue> values;
  bool cut_by_border = false;
};

/// nullopt: not seen, or too near the silhouette to say how the slope changes.
std::optional<ExpectedHighlight> expect_highlight(const acquire::RigGeometry& rig, const acquire::PlacedLight& light);

/// Values within `radius_px` of `about` whose normal is at least `min_cosine` from the line of sight. `corner`: pixel of the camera at which
/// `image` begins.
HighlightWindow collect_window(const RadianceImage& image, const glm::ivec2& corner, const Calibration& calibration, const ExpectedHighlight& expected,
                               const glm::dvec2& about, double radius_px, double min_cosine);

/// Brightness of a window without the mirror factor, channels brought to one level: each pixel is the mean over 3 x 3.
class PeakMap {
 public:
  explicit PeakMap(const std::vector<HighlightValue>& values);
  struct Peak {
    glm::dvec2 pixel;
    double height;
  };
  /// The brightest pixel at least `distance` from `from`.
  std::optional<Peak> brightest(const glm::dvec2& from, double distance) const;
  double level() const { return level_; }  ///< median
  /// Number of pixels around the peak, connected to it, that are brighter than halfway between level and peak.
  std::size_t area_above_half(const Peak& peak) const;

 private:
  std::size_t index(int x, int y) const { return static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) + static_cast<std::size_t>(x); }
  glm::ivec2 corner_{0};
  int width_ = 0, height_ = 0;
  std::vector<float> mean_;  ///< NaN: too few values
  double level_ = 0;
};

}  // namespace lacquer::calib
