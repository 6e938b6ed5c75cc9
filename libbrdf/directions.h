#pragma once

#include <glm/vec3.hpp>

namespace lacquer::brdf {

/// A pair of unit directions in the shading frame (z = normal), both pointing away from the surface:
/// `wi` towards the light, `wo` towards the camera.
struct Directions {
  glm::dvec3 wi;
  glm::dvec3 wo;
};

/// Isotropic half/difference coordinates of Rusinkiewicz 1998, radians.
struct HalfDiff {
  double theta_h;  ///< angle between normal and half vector, [0, pi/2]
  double theta_d;  ///< angle between half vector and wi, [0, pi/2]
  double phi_d;    ///< azimuth of wi about the half vector, (-pi, pi]; 0: in the plane of normal and half vector, away from the normal
};

/// Spread of the half vector over what one measurement sees (pixel, lens blur, emitter): covariance of its slope against the normal in the
/// axes along (theta_h grows) and across. Matters where a lobe is not much wider.
template <typename T>
struct Footprint {
  T along = 0;   ///< variance, >= 0
  T across = 0;  ///< variance, >= 0
  T mixed = 0;   ///< covariance, mixed^2 <= along * across
};

/// The cosines that an isotropic, reciprocal microfacet model needs. `T`: float or double.
/// tan^2(theta_h) is kept apart because 1 - cos^2 loses all digits at the peak of a clear coat.
template <typename T>
struct HalfAngleCosines {
  T n_dot_i;       ///< cos(theta_i)
  T n_dot_o;       ///< cos(theta_o)
  T n_dot_h;       ///< cos(theta_h)
  T i_dot_h;       ///< cos(theta_d)
  T tan2_theta_h;  ///< tan^2(theta_h)
  Footprint<T> footprint = {};  ///< of the measurement; all 0 for a point
};

/// Half/difference coordinates of two unit directions. Accurate to a few ulp at h = n, wi = wo and at grazing.
/// Where an azimuth is undefined (wi = wo) phi_d is 0. wi = -wo has no half vector: theta_h = 0, theta_d = pi/2 by convention.
HalfDiff half_diff(const Directions& d);

/// Inverse of half_diff with the half vector in the x-z plane (phi_h = 0). One of the directions may lie below the horizon
/// (z < 0): such coordinates exist in the table's grid but not on a surface.
Directions directions(const HalfDiff& c);

/// Cosines of two unit directions.
HalfAngleCosines<double> half_angle_cosines(const Directions& d);

/// Cosines of half/difference coordinates, without the detour over vectors.
HalfAngleCosines<double> half_angle_cosines(const HalfDiff& c);

/// phi_d folded by reciprocity, f(phi_d) = f(phi_d + pi), into [0, pi).
double fold_phi_d(double phi_d);

/// Unit direction of spherical coordinates, radians; z = normal.
glm::dvec3 direction(double theta, double phi);

}  // namespace lacquer::brdf
