#pragma once

#include <functional>
#include <map>
#include <vector>

#include "libacquire/session.h"
#include "libbrdf/progress.h"
#include "libcalib/calibration.h"
#include "libcalib/geometry_solver.h"
#include "libcalib/highlights.h"
#include "libcalib/radiance_image.h"
#include "libcalib/sphere_outline.h"

namespace lacquer::calib {

struct SessionGeometry {
  GeometryEstimate estimate;
  std::size_t n_views = 0;
  std::size_t n_arcs = 0;          ///< of the silhouette, in all
  std::size_t n_dark_arcs = 0;     ///< that no light ever reached
  std::vector<EdgePoint> edges;
  std::vector<Highlight> highlights;
  std::map<HighlightFate, std::vector<std::string>> rejected;  ///< views, by reason
};

/// A merged view and where its image comes from. `read` may be called several times.
struct GeometryView {
  std::string id;
  std::size_t light = 0;
  double turntable_angle = 0;  ///< radians, read back
  std::function<RadianceImage()> read;
};

/// Sphere, axis and lights from merged images; the result also goes into `calibration` (geometry, turntable_scale, geometry_uncertainty,
/// geometry_source). Begins with `nominal`, the rig file's, whatever `calibration` has. Highlights are measured again with the geometry
/// they gave, three times in all. Throws Error{input} where the rig cannot be estimated or no highlight is seen: what to do is in the
/// text, which begins with `name`.
SessionGeometry estimate_geometry(const std::string& name, const acquire::RigGeometry& nominal, const std::vector<GeometryView>& views,
                                  Calibration& calibration, const GeometryPriors& priors, const HighlightOptions& highlight_options,
                                  const Progress& progress);

/// The measurement views of a session; read() throws Error{file} where an image is missing or not as the rig's camera. Refers to `session`.
std::vector<GeometryView> geometry_views(const acquire::Session& session);

/// The same from the radiance images of a session. Throws Error{file} where one is missing or not as the rig's camera.
SessionGeometry estimate_geometry(const acquire::Session& session, Calibration& calibration, const GeometryPriors& priors,
                                  const HighlightOptions& highlight_options, const Progress& progress);

}  // namespace lacquer::calib
