#pragma once

#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "libcalib/geometry_session.h"

/// Lights so far away that only their directions count: each from the mirror highlight on a sphere, one image each.
namespace lacquer::calib {

struct DistantLight {
  std::string view;
  std::size_t light = 0;
  HighlightFate fate = HighlightFate::hidden;
  glm::dvec3 given{0.0};      ///< unit, rig frame, towards the light as it stands in this view, from the rig file
  glm::dvec2 pixel{0.0};      ///< of the highlight, if found
  glm::dvec3 direction{0.0};  ///< the line of sight mirrored at the sphere there, rig frame, as it stands in this view
  double sigma_rad = 0;       ///< of the direction, larger axis, from the highlight alone; the sphere's own error comes besides
  double off_rad = 0;         ///< angle between the two
};

/// What highlights and given directions say together: one turn of all given directions and another place and size of the sphere's outline,
/// least squares with a Cauchy loss, without any knowledge of the silhouette.
struct JointDirections {
  glm::dvec3 turn{0.0}, turn_sigma{0.0};            ///< rotation vector in the rig frame, radians
  glm::dvec2 shift_px{0.0}, shift_sigma_px{0.0};    ///< of the sphere's centre in the image, against the silhouette
  double radius_px = 0, radius_sigma_px = 0;        ///< change of the outline's radius
  double median_off_rad = 0;                        ///< left between directions
  bool solved = false;                              ///< false: fewer than 6 highlights
};

struct DistantLights {
  GeometryEstimate sphere;    ///< from the silhouette alone
  std::size_t n_arcs = 0;
  glm::dvec2 centre_px{0.0};  ///< of the outline
  double radius_px = 0;
  std::vector<DistantLight> lights;  ///< one per view
  double median_off_rad = 0, largest_off_rad = 0;  ///< of those found
  JointDirections joint;
};

bool all_lights_distant(const acquire::RigGeometry& rig);

/// Sphere from the silhouette, then each light's direction from its highlight; both go into `calibration` (geometry, geometry_source). A light
/// without a highlight keeps the direction of the rig file, one with several views gets their mean. How far the sphere is and how large
/// cannot be told apart and does not matter: its place is that of a sphere of the rig file's radius. Throws Error{input} where no
/// silhouette or no highlight is found.
DistantLights find_distant_lights(const std::string& name, const acquire::RigGeometry& nominal, const std::vector<GeometryView>& views,
                                  Calibration& calibration, const HighlightOptions& options, const Progress& progress);

}  // namespace lacquer::calib
