#pragma once

#include <cstddef>
#include <vector>

#include "libacquire/rig_geometry.h"

namespace lacquer::calib {

/// How far a geometry is from another, in what samples depend on; RMS over views, and of half vectors over the pixels that samples come
/// from (light and camera less than 85 degrees from the normal).
struct GeometryDifference {
  double half_vector_rad = 0;  ///< half vector against normal
  double light_rad = 0;        ///< direction of the light from the sphere's centre
  double distance = 0;         ///< of the light from the sphere's centre, relative
  double centre_px = 0;        ///< of the sphere in the image
};

/// A view, with the turntable's angle as each of the two geometries has it (radians, its scale included).
struct ViewAngles {
  std::size_t light = 0;
  double angle = 0, true_angle = 0;
};

/// `grid`: pixels in the image's height, of a square grid. Distant lights are left out.
GeometryDifference geometry_difference(const acquire::RigGeometry& geometry, const acquire::RigGeometry& truth, const std::vector<ViewAngles>& views,
                                       int grid = 60);

}  // namespace lacquer::calib
