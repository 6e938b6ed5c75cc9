#include "libacquire/rig_geometry.h"

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/matrix.hpp>

#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

/// Distortion of OpenCV's rational model: value and Jacobian (it is symmetric) at normalised image coordinates.
struct Distorted {
  glm::dvec2 p;
  double dx_dx, mixed, dy_dy;
};

/// Radial factor N(r^2) / D(r^2) and its derivative by r^2; nullopt at a pole (D <= 0).
struct RadialFactor {
  double value, derivative;
};

std::optional<RadialFactor> radial_factor(const std::array<double, 8>& k, double r2) {
  const double numerator = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
  const double denominator = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]));
  if (!(denominator > 0)) return std::nullopt;
  const double d_numerator = k[0] + r2 * (2 * k[1] + r2 * 3 * k[4]);
  const double d_denominator = k[5] + r2 * (2 * k[6] + r2 * 3 * k[7]);
  const double inverse = 1 / denominator, value = numerator * inverse;
  return RadialFactor{value, (d_numerator - value * d_denominator) * inverse};
}

/// OpenCV calib3d, "Detailed Description": k1 k2 p1 p2 k3 k4 k5 k6.
std::optional<Distorted> distort(const std::array<double, 8>& k, const glm::dvec2& p) {
  const double x = p.x, y = p.y, p1 = k[2], p2 = k[3];
  const double r2 = x * x + y * y;
  const auto radial = radial_factor(k, r2);
  if (!radial) return std::nullopt;
  const double f = radial->value, df = 2 * radial->derivative;
  return Distorted{{x * f + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * f + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y},
                   f + df * x * x + 2 * p1 * y + 6 * p2 * x,
                   df * x * y + 2 * p1 * x + 2 * p2 * y,
                   f + df * y * y + 6 * p1 * y + 2 * p2 * x};
}

/// The radial part grows all the way from the centre to `r2`: the point lies on the branch that a lens has, not beyond a fold.
bool on_first_branch(const std::array<double, 8>& k, double r2) {
  // d(r N / D)/dr > 0 certainly holds where A = |N - 1| and B = |D - 1| are small: (1 - A)(1 - B) > 6 A (1 + B) + 6 B (1 + A).
  const double a = r2 * (std::abs(k[0]) + r2 * (std::abs(k[1]) + r2 * std::abs(k[4])));
  const double b = r2 * (std::abs(k[5]) + r2 * (std::abs(k[6]) + r2 * std::abs(k[7])));
  if ((1 - a) * (1 - b) > 6 * (a * (1 + b) + b * (1 + a)) && b < 1) return true;
  constexpr int n_steps = 16;
  for (int i = 1; i <= n_steps; ++i) {
    const double s = r2 * i / n_steps;
    const auto radial = radial_factor(k, s);
    if (!radial || !(radial->value + 2 * s * radial->derivative > 0)) return false;
  }
  return true;
}

/// Newton iteration for distort(p) = target.
std::optional<glm::dvec2> undistort(const std::array<double, 8>& k, const glm::dvec2& target) {
  constexpr int max_iterations = 50;
  constexpr double last_step = 1e-7;  // of the normalised coordinates; convergence is quadratic, so 1e-14 is left after it
  glm::dvec2 p = target;
  for (int i = 0; i < max_iterations; ++i) {
    const auto d = distort(k, p);
    if (!d) return std::nullopt;
    const glm::dvec2 residual = target - d->p;
    const double det = d->dx_dx * d->dy_dy - d->mixed * d->mixed;
    if (!(det > 0)) return std::nullopt;
    const glm::dvec2 step = glm::dvec2(d->dy_dy * residual.x - d->mixed * residual.y, d->dx_dx * residual.y - d->mixed * residual.x) / det;
    p += step;
    if (glm::dot(step, step) <= last_step * last_step) {
      if (!on_first_branch(k, glm::dot(p, p))) return std::nullopt;
      return p;
    }
  }
  return std::nullopt;
}

bool is_distorted(const CameraModel& camera) {
  for (const double k : camera.distortion)
    if (k != 0) return true;
  return false;
}

/// Two unit vectors that complete `n` to a right-handed frame, without a singular direction.
/// Duff et al. 2017, "Building an Orthonormal Basis, Revisited".
struct Tangents {
  glm::dvec3 u, v;
};

Tangents tangents(const glm::dvec3& n) {
  const double sign = std::copysign(1.0, n.z);
  const double a = -1 / (sign + n.z), b = n.x * n.y * a;
  return {{1 + sign * n.x * n.x * a, sign * b, -sign * n.x}, {b, sign + n.y * n.y * a, -n.y}};
}

/// `p` turned by `angle` about the unit vector `axis` (Rodrigues), right-handed.
glm::dvec3 rotate(const glm::dvec3& p, const glm::dvec3& axis, double angle) {
  const double c = std::cos(angle), s = std::sin(angle);
  return c * p + s * glm::cross(axis, p) + (1 - c) * glm::dot(axis, p) * axis;
}

}  // namespace

RigidTransform RigidTransform::inverse() const {
  const glm::dmat3 transposed = glm::transpose(rotation);
  return {transposed, -(transposed * translation)};
}

std::optional<glm::dvec2> CameraModel::project(const glm::dvec3& p_cam) const {
  if (projection == Projection::orthographic) return focal * glm::dvec2(p_cam) + centre;
  if (!(p_cam.z > 0)) return std::nullopt;
  const glm::dvec2 normalised = glm::dvec2(p_cam) / p_cam.z;
  if (!is_distorted(*this)) return focal * normalised + centre;
  const auto distorted = distort(distortion, normalised);
  if (!distorted) return std::nullopt;
  return focal * distorted->p + centre;
}

std::optional<Ray> CameraModel::unproject(const glm::dvec2& pixel) const {
  const glm::dvec2 normalised = (pixel - centre) / focal;
  if (projection == Projection::orthographic) return Ray{{normalised, 0}, {0, 0, 1}};
  if (!is_distorted(*this)) return Ray{glm::dvec3(0), glm::normalize(glm::dvec3(normalised, 1))};
  const auto undistorted = undistort(distortion, normalised);
  if (!undistorted) return std::nullopt;
  return Ray{glm::dvec3(0), glm::normalize(glm::dvec3(*undistorted, 1))};
}

PlacedLight RigGeometry::place_light(std::size_t index, double angle) const {
  const Light& light = lights.at(index);
  const double turned = light.on_arm ? angle : 0;
  PlacedLight placed;
  placed.distant = light.distant;
  placed.intensity = light.intensity;
  placed.falloff_exponent = light.falloff_exponent;
  if (light.distant) {
    placed.direction = rotate(light.direction, axis_direction, turned);
    placed.axis = -placed.direction;
    return placed;
  }
  placed.diameter = light.diameter;
  placed.position = axis_point + rotate(light.position - axis_point, axis_direction, turned);
  placed.axis = rotate(-glm::normalize(light.position), axis_direction, turned);
  placed.direction = glm::normalize(placed.position);
  return placed;
}

std::optional<SurfacePoint> trace(const RigGeometry& rig, const glm::dvec2& pixel) {
  const auto ray = rig.camera.unproject(pixel);
  if (!ray) return std::nullopt;
  const glm::dmat3 rig_from_cam = glm::transpose(rig.cam_from_rig.rotation);
  const glm::dvec3 origin = rig_from_cam * (ray->origin - rig.cam_from_rig.translation);
  const glm::dvec3 direction = rig_from_cam * ray->direction;

  // Haines et al. 2019, "Precision Improvements for Ray/Sphere Intersection": the point of the ray nearest to the centre first,
  // then along the ray to the surface. |nearest| stays of the order of the radius however far away the camera is.
  const double along = glm::dot(origin, direction);
  const glm::dvec3 nearest = origin - along * direction;
  const double r = rig.sphere_radius;
  const double half_chord_2 = (r - glm::length(nearest)) * (r + glm::length(nearest));
  if (!(half_chord_2 >= 0)) return std::nullopt;
  const double half_chord = std::sqrt(half_chord_2);
  const bool perspective = rig.camera.projection == CameraModel::Projection::pinhole;
  if (perspective && !(-along - half_chord > 0)) return std::nullopt;
  const glm::dvec3 position = nearest - half_chord * direction;
  return SurfacePoint{position, glm::normalize(position), -direction};
}

std::optional<Illumination> illuminate(const PlacedLight& light, const SurfacePoint& point, const glm::dvec2& offset) {
  if (light.distant) {
    const double cos_i = glm::dot(point.normal, light.direction);
    if (!(cos_i > 0)) return std::nullopt;
    return Illumination{light.direction, light.intensity * cos_i};
  }
  glm::dvec3 source = light.position;
  if (offset.x != 0 || offset.y != 0) {
    const Tangents t = tangents(light.axis);
    source += offset.x * t.u + offset.y * t.v;
  }
  const glm::dvec3 to_light = source - point.position;
  const double distance_2 = glm::dot(to_light, to_light);
  const glm::dvec3 wi = to_light / std::sqrt(distance_2);
  const double cos_i = glm::dot(point.normal, wi);
  if (!(cos_i > 0)) return std::nullopt;
  double falloff = 1;
  if (light.falloff_exponent != 0) {
    const double cos_off_axis = -glm::dot(wi, light.axis);
    if (!(cos_off_axis > 0)) return std::nullopt;
    falloff = light.falloff_exponent == 1 ? cos_off_axis : std::pow(cos_off_axis, light.falloff_exponent);
  }
  return Illumination{wi, light.intensity * (falloff * cos_i / distance_2)};
}

LocalDirections to_shading_frame(const SurfacePoint& point, const glm::dvec3& wi) {
  const auto [u, v] = tangents(point.normal);
  const auto local = [&, u = u, v = v](const glm::dvec3& w) { return glm::dvec3(glm::dot(u, w), glm::dot(v, w), glm::dot(point.normal, w)); };
  return {local(wi), local(point.wo)};
}

RigidTransform look_at(const glm::dvec3& position, const glm::dvec3& target, const glm::dvec3& up) {
  const glm::dvec3 forward = glm::normalize(target - position);
  const glm::dvec3 side = glm::cross(forward, up);
  const double length = glm::length(side);
  if (!(length > 1e-9 * glm::length(up)))
    throw Error(ErrorCode::input, "camera pose: up is parallel to the line of sight (or position equals target), expected another up");
  const glm::dvec3 right = side / length, down = glm::cross(forward, right);
  const glm::dmat3 rotation = glm::transpose(glm::dmat3(right, down, forward));
  return {rotation, -(rotation * position)};
}

}  // namespace lacquer::acquire
