#pragma once

#include <cmath>
#include <numbers>

/// Axes of the unit square of RGL's tensor files, shared by reader and writer.
namespace lacquer::brdf {

/// Square coordinate of a polar angle: theta = u^2 pi/2.
inline double rgl_u_from_theta(double theta) { return std::sqrt(theta * (2 / std::numbers::pi)); }
inline double rgl_theta_from_u(double u) { return u * u * (std::numbers::pi / 2); }

/// Square coordinate of an azimuth in (-pi, pi]: phi = (2u - 1) pi; the seam belongs to u = 0, as in the reference loader.
inline double rgl_u_from_phi(double phi) {
  const double u = (phi + std::numbers::pi) / (2 * std::numbers::pi);
  return u - std::floor(u);
}
inline double rgl_phi_from_u(double u) { return (2 * u - 1) * std::numbers::pi; }

}  // namespace lacquer::brdf
