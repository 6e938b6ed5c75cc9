#pragma once

#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>

#include "libacquire/rig_geometry.h"

/// What a camera sees of a sphere: its outline and the mirror image of a light.
namespace lacquer::calib {

/// `p` turned about the unit vector `axis`, right-handed (Rodrigues).
glm::dvec3 rotate(const glm::dvec3& p, const glm::dvec3& axis, double angle);

/// Where the camera sees the mirror image of a point light in the sphere: the plane problem solved to rounding, then projected.
/// nullopt: the camera cannot see it, or the light is inside the sphere. Pinhole only.
std::optional<glm::dvec2> mirror_pixel(const acquire::RigGeometry& rig, const glm::dvec3& light);

/// Distance of a pixel from the projected silhouette, pixels, positive outside: the angle between line of sight and cone, times the
/// lens' scale there. nullopt: the lens has no line of sight there. Pinhole only.
std::optional<double> silhouette_distance(const acquire::RigGeometry& rig, const glm::dvec2& pixel);
/// The same for a pixel whose line of sight is known: a unit vector in the camera frame.
std::optional<double> silhouette_distance(const acquire::RigGeometry& rig, const glm::dvec2& pixel, const glm::dvec3& line_of_sight);

}  // namespace lacquer::calib
