#include "libcalib/geometry_projection.h"

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

namespace lacquer::calib {

namespace {

/// Normal of the reflecting point, as the angle from the camera's direction towards the light's, both `to_light` apart and seen from the
/// sphere's centre; lengths in radii. Alhazen's problem: the normal bisects the directions to camera and light.
std::optional<double> reflecting_angle(double camera, double light, double to_light) {
  if (!(camera > 1 && light > 1)) return std::nullopt;
  double low = 0, high = to_light;
  double a = 0.5 * to_light;
  for (int i = 0; i < 100; ++i) {
    const double sine = std::sin(a), cosine = std::cos(a), light_sine = light * std::sin(to_light - a), light_cosine = std::cos(to_light - a);
    // Angle of incidence less angle of reflection: between the directions (cosine, sine) to the light and to the camera.
    const double lx = light * light_cosine - 1, cx = camera * cosine - 1, cy = camera * sine;
    const double excess = std::atan2(light_sine * cx - lx * cy, lx * cx + light_sine * cy);  // falls from > 0 to < 0
    (excess > 0 ? low : high) = a;
    const auto slope = [](double d, double cosine_there) { return d * (d - cosine_there) / (d * d - 2 * d * cosine_there + 1); };
    double next = a + excess / (slope(light, light_cosine) + slope(camera, cosine));
    if (!(next > low && next < high)) next = 0.5 * (low + high);
    if (std::abs(next - a) < 1e-15) break;
    a = next;
  }
  if (!(camera * std::cos(a) > 1 && light * std::cos(to_light - a) > 1)) return std::nullopt;  // behind the horizon of one of them
  return a;
}

}  // namespace

glm::dvec3 rotate(const glm::dvec3& p, const glm::dvec3& axis, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return c * p + s * glm::cross(axis, p) + (1 - c) * glm::dot(axis, p) * axis;
}

std::optional<glm::dvec2> mirror_pixel(const acquire::RigGeometry& rig, const glm::dvec3& light) {
  const acquire::RigidTransform& pose = rig.cam_from_rig;
  const glm::dvec3 camera = -(glm::transpose(pose.rotation) * pose.translation);
  const double camera_distance = glm::length(camera), light_distance = glm::length(light);
  const glm::dvec3 u = camera / camera_distance, cross = glm::cross(u, light);
  const double sine = glm::length(cross);
  const auto a = reflecting_angle(camera_distance / rig.sphere_radius, light_distance / rig.sphere_radius, std::atan2(sine, glm::dot(u, light)));
  if (!a) return std::nullopt;
  const glm::dvec3 across = sine > 1e-14 * light_distance ? glm::cross(cross / sine, u) : glm::dvec3(0);
  return rig.camera.project(pose * (rig.sphere_radius * (std::cos(*a) * u + std::sin(*a) * across)));
}

std::optional<double> silhouette_distance(const acquire::RigGeometry& rig, const glm::dvec2& pixel) {
  const auto ray = rig.camera.unproject(pixel);
  if (!ray) return std::nullopt;
  return silhouette_distance(rig, pixel, ray->direction);
}

std::optional<double> silhouette_distance(const acquire::RigGeometry& rig, const glm::dvec2& pixel, const glm::dvec3& line_of_sight) {
  const glm::dvec3& centre = rig.cam_from_rig.translation;
  const double distance = glm::length(centre);
  const glm::dvec3 axis = centre / distance, cross = glm::cross(axis, line_of_sight);
  const double cone = std::asin(rig.sphere_radius / distance), angle = std::atan2(glm::length(cross), glm::dot(axis, line_of_sight));
  // The nearest line of sight of the cone, projected: the distance is exact where it matters, at the silhouette.
  if (!(angle > 1e-9)) return -rig.camera.focal.x * cone;
  const auto touching = rig.camera.project(rotate(axis, glm::normalize(cross), cone));
  if (!touching) return std::nullopt;
  return std::copysign(glm::length(pixel - *touching), angle - cone);
}

}  // namespace lacquer::calib
