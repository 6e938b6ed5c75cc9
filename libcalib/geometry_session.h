#pragma once

#include <map>

#include "libacquire/session.h"
#include "libbrdf/progress.h"
#include "libcalib/calibration.h"
#include "libcalib/geometry_solver.h"
#include "libcalib/highlights.h"
#include "libcalib/sphere_outline.h"

namespace lacquer::calib {

struct SessionGeometry {
  GeometryEstimate estimate;
  std::size_t n_views = 0;
  std::size_t n_arcs = 0;          ///< of the silhouette, in all
  std::size_t n_dark_arcs = 0;     ///< that no light ever reached
  std::vector<Highlight> highlights;
  std::map<HighlightFate, std::vector<std::string>> rejected;  ///< views, by reason
};

/// Sphere, axis and lights from the merged images of a session; the result also goes into `calibration` (geometry, turntable_scale,
/// geometry_uncertainty, geometry_source). Begins with the rig file's geometry, whatever `calibration` has. Highlights are measured again
/// with the geometry they gave, three times in all. Throws Error{file} where a radiance image is missing, Error{input} where the
/// rig cannot be estimated or neither silhouette nor highlights are seen: what to do is in the text.
SessionGeometry estimate_geometry(const acquire::Session& session, Calibration& calibration, const GeometryPriors& priors,
                                  const HighlightOptions& highlight_options, const Progress& progress);

}  // namespace lacquer::calib
