#pragma once

#include <functional>
#include <map>
#include <vector>

#include "libacquire/session.h"
#include "libbrdf/progress.h"
#include "libcalib/calibration.h"
#include "libcalib/geometry_solver.h"
#include "libcalib/highlights.h"
#include "libcalib/paint_evidence.h"
#include "libcalib/radiance_image.h"
#include "libcalib/sphere_outline.h"

namespace lacquer::calib {

struct SessionGeometry {
  GeometryEstimate estimate;
  std::size_t n_views = 0;
  std::size_t n_arcs = 0;          ///< of the silhouette, in all
  std::size_t n_dark_arcs = 0;     ///< that no light ever reached
  double lens_blur_px = 0;         ///< as the rig file states it, or as the limb shows it where it does not
  std::vector<EdgePoint> edges;
  std::vector<Highlight> highlights;
  std::map<HighlightFate, std::vector<std::string>> rejected;  ///< views, by reason
  /// What the light on the paint said besides.
  struct Paint {
    std::size_t n_samples = 0;   ///< 0: it was not asked, or gave too few
    double scatter = 0;          ///< relative, of samples about the paint, without their noise
    double distance_sigma_before = 0, half_vector_sigma_before = 0;  ///< what silhouette and highlights alone are good for
  } paint;
};

struct GeometryOptions {
  GeometryPriors priors;
  HighlightOptions highlights;
  PaintOptions paint;
  bool use_paint = true;  ///< the pattern of light on the paint, besides silhouette and highlights
};

/// A merged view and where its image comes from.
struct GeometryView {
  std::string id;
  std::size_t light = 0;
  double turntable_angle = 0;  ///< radians, read back
  double factor = 1;           ///< on the light's intensity: its drift
  std::function<RadianceImage()> read;  ///< may be called several times
};

/// Sphere, axis and lights from merged images; the result also goes into `calibration` (geometry, turntable_scale, geometry_uncertainty,
/// geometry_source). Begins with `nominal`, the rig file's, whatever `calibration` has but the covariance of its lens, whose intrinsics are unknowns
/// then. Each image is read twice: for the silhouette, then
/// for highlights and paint. Highlights are measured again with the geometry they gave, three times in all; then the paint refines it.
/// `mask`: what of the sphere is paint. Throws Error{input} where the rig cannot be estimated, or neither highlights nor paint say enough: what
/// to do is in the text, which begins with `name`.
SessionGeometry estimate_geometry(const std::string& name, const acquire::RigGeometry& nominal, const acquire::MaskDescription& mask,
                                  const std::vector<GeometryView>& views, Calibration& calibration, const GeometryOptions& options,
                                  const Progress& progress);

/// The measurement views of a session, their lights followed as `calibration` has it; read() throws Error{file} where an image is missing or
/// not as the rig's camera. Refers to `session`.
std::vector<GeometryView> geometry_views(const acquire::Session& session, const Calibration& calibration);

/// The same from the radiance images of a session. Throws Error{file} where one is missing or not as the rig's camera.
SessionGeometry estimate_geometry(const acquire::Session& session, Calibration& calibration, const GeometryOptions& options, const Progress& progress);

}  // namespace lacquer::calib
