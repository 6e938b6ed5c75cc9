#pragma once

#include <array>
#include <glm/mat3x3.hpp>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <string>
#include <vector>

/// Geometry of a rig, shared by the simulated rig (truth) and the calibration (estimate): the same equations, other numbers.
/// Rig frame: origin in the sphere's centre, y along the turntable's axis (up), z towards the camera at turntable angle 0.
/// Camera frame as OpenCV and mrcal: x right, y down, z forward; pixel (0, 0) is the CENTRE of the first pixel. Metres, radians.
namespace lacquer::acquire {

/// p_a = rotation * p_b + translation
struct RigidTransform {
  glm::dmat3 rotation{1.0};
  glm::dvec3 translation{0.0};
  glm::dvec3 operator*(const glm::dvec3& p) const { return rotation * p + translation; }
  RigidTransform inverse() const;
};

/// Line of sight in the camera frame: points origin + t * direction; direction is a unit vector. Pinhole: t > 0.
struct Ray {
  glm::dvec3 origin;
  glm::dvec3 direction;
};

/// Pinhole with OpenCV distortion (k1 k2 p1 p2 k3 k4 k5 k6, the rational model: LENSMODEL_OPENCV8 of mrcal), or orthographic
/// (a distant camera: no distortion, and a point is seen whatever its depth).
struct CameraModel {
  enum class Projection { pinhole, orthographic };
  Projection projection = Projection::pinhole;
  int width = 0;                 ///< pixels
  int height = 0;                ///< pixels
  glm::dvec2 focal{0.0};         ///< pinhole: fx, fy in pixels; orthographic: pixels per metre
  glm::dvec2 centre{0.0};        ///< principal point, pixels
  std::array<double, 8> distortion{};

  /// Pixel of a point in the camera frame; nullopt behind a pinhole camera and beyond a pole of the distortion.
  std::optional<glm::dvec2> project(const glm::dvec3& p_cam) const;
  /// Inverse of project (Newton iteration to 1e-12 of the normalised coordinates). nullopt where the distortion cannot be inverted:
  /// beyond the radius where it folds the image over.
  std::optional<Ray> unproject(const glm::dvec2& pixel) const;
};

/// One light. Near point light (`position`) or distant (`direction`).
struct Light {
  std::string name = {};
  bool distant = false;
  bool on_arm = true;              ///< turns with the turntable
  glm::dvec3 position{0.0};        ///< near: metres, rig frame at turntable angle 0
  glm::dvec3 direction{0, 0, 1};   ///< distant: unit vector from the sphere towards the light, rig frame at angle 0
  glm::dvec3 intensity{1.0};       ///< near: radiant intensity on axis per channel, W/sr; distant: irradiance normal to the light, W/m^2
  double diameter = 0;             ///< emitter, metres (near only)
  double falloff_exponent = 0;     ///< near: intensity ~ cos^g of the angle off the axis light -> sphere centre
};

/// The light as it stands at one turntable angle.
struct PlacedLight {
  bool distant = false;
  glm::dvec3 position{0.0};
  glm::dvec3 direction{0, 0, 1};
  glm::dvec3 axis{0, 0, -1};       ///< unit, from the light towards where it is aimed
  glm::dvec3 intensity{1.0};
  double diameter = 0;
  double falloff_exponent = 0;
};

struct RigGeometry {
  CameraModel camera;
  RigidTransform cam_from_rig;
  double sphere_radius = 0.05;             ///< metres
  glm::dvec3 axis_direction{0, 1, 0};      ///< turntable axis, unit, rig frame
  glm::dvec3 axis_point{0.0};              ///< a point on it, metres, rig frame
  std::vector<Light> lights;

  /// Light `index` with the turntable at `angle` (radians, right-handed about axis_direction). At angle 0 a near light is aimed at
  /// the origin; the arm carries position and aim rigidly. Throws std::out_of_range.
  PlacedLight place_light(std::size_t index, double angle) const;
};

/// Point of the sphere that a pixel sees.
struct SurfacePoint {
  glm::dvec3 position;  ///< rig frame, metres
  glm::dvec3 normal;    ///< unit, outwards
  glm::dvec3 wo;        ///< unit, towards the camera, rig frame
};

/// First intersection of the line of sight of `pixel` (any sub-pixel position) with the sphere; nullopt: it misses, or the sphere is
/// behind or around a pinhole camera.
std::optional<SurfacePoint> trace(const RigGeometry& rig, const glm::dvec2& pixel);

struct Illumination {
  glm::dvec3 wi;          ///< unit, towards the light, rig frame
  glm::dvec3 irradiance;  ///< per channel, cosine included, W/m^2; > 0
};

/// Irradiance at a surface point from a point of the light (`offset`: metres in the emitter's plane, which is normal to its axis);
/// nullopt: shadowed side. Near: E = I cos^g(angle off axis) cos(theta_i) / d^2; distant: E = intensity cos(theta_i).
std::optional<Illumination> illuminate(const PlacedLight& light, const SurfacePoint& point, const glm::dvec2& offset = glm::dvec2(0.0));

/// The two directions in the shading frame of `point` (z = normal).
struct LocalDirections {
  glm::dvec3 wi, wo;
};
LocalDirections to_shading_frame(const SurfacePoint& point, const glm::dvec3& wi);

/// Camera pose (cam_from_rig) that looks from `position` at `target` with `up` upwards in the image. Throws Error{input}.
RigidTransform look_at(const glm::dvec3& position, const glm::dvec3& target, const glm::dvec3& up);

}  // namespace lacquer::acquire
