#pragma once

#include <optional>
#include <vector>

#include "libacquire/session.h"
#include "libbrdf/brdf.h"
#include "libbrdf/progress.h"
#include "libcalib/calibration.h"
#include "libcalib/radiance_image.h"

/// Absolute scale of f_r from a standard of known reflectance that stood where the painted sphere stands. Equations in docs/lens.md.
namespace lacquer::calib {

/// The standard, in the rig frame.
struct ScaleReference {
  std::shared_ptr<const brdf::Brdf> brdf;  ///< of its surface
  double sigma = 0;             ///< relative standard error of its reflectance
  double light_sigma = 0;       ///< relative standard deviation of the lights from one capture to the other
  double radius = 0;            ///< of a sphere about the origin, metres; 0: as the painted one
  struct Plate {
    glm::dvec3 normal{0, 0, 1};      ///< towards the camera's side
    glm::dvec3 point{0.0};           ///< of its surface, metres
    acquire::PixelRectangle pixels;  ///< where nothing but the plate is seen
  };
  std::optional<Plate> plate;   ///< instead of the sphere
  bool fit_falloff = true;      ///< the exponent of near lights is found too; else the calibration's is believed
  double min_cosine = 0.34;     ///< of light and camera: whites are Lambertian up to about 70 degrees
  void validate() const;        ///< Throws Error{usage}.
};

/// What one light turned out to be.
struct LightScale {
  glm::dvec3 factor{1.0};           ///< intensity over the calibration's, R G B (mono: all alike)
  glm::dvec3 factor_sigma{0.0};     ///< relative, from the scatter between regions of the image
  double falloff_exponent = 0, falloff_sigma = 0;  ///< sigma 0: believed, not found
  std::size_t n_used = 0, n_left_out = 0;
  double rms = 0;                   ///< relative, of the pixels about the model
};

struct ScaleEstimate {
  std::vector<LightScale> lights;
  double sigma = 0;  ///< relative, of the scale as a whole: standard, lights, scatter
};

/// One view of the standard. `calibration`: of the rig, whose intensity the light's factor refers to; `factor`: the drift of the light in this view.
/// Throws Error{input}: fewer than 100 usable values.
LightScale light_scale(const RadianceImage& image, const Calibration& calibration, std::size_t light, double turntable_angle, double factor,
                       const ScaleReference& reference);

/// `white`: a session of `lacquer capture --white-reference`, merged with `white_calibration`. Throws Error{input} where it is of another camera, has other
/// lights, lacks a light, or has another response.
ScaleEstimate estimate_scale(const acquire::Session& white, const Calibration& white_calibration, const Calibration& calibration, const ScaleReference& reference);

/// Takes it over: intensities and falloff of the lights, absolute scale and its sigma. `source`: in words, for scale_source.
void apply_scale(const ScaleEstimate& estimate, const std::string& source, Calibration& calibration);

}  // namespace lacquer::calib
