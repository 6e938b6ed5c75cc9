#pragma once

#include <cstddef>
#include <glm/vec3.hpp>
#include <vector>

#include "libbrdf/brdf.h"

namespace lacquer::brdf {

/// Which directions two BRDFs are compared at.
struct CompareOptions {
  double max_theta = 80.0 / 180.0 * 3.14159265358979323846;  ///< radians; both directions at most this far from the normal
  int phi_d_step = 2;      ///< every n-th phi_d cell of the table's grid (1 = all); the grid's own cell centres are the directions
  bool scale = false;      ///< true: B is first multiplied by the one factor that makes the mean log ratio 0 (relative measurements)
  void validate() const;   ///< throws Error{usage} naming the field
};

/// Difference of B from A. Directions: centres of the half-angle table's cells within max_theta, where both BRDFs say something.
struct BrdfDifference {
  std::size_t n_directions = 0;    ///< compared
  std::size_t n_undefined = 0;     ///< left out: one of the two says nothing there
  std::size_t n_nonpositive = 0;   ///< direction-channels left out of the log ratio: a value <= 0
  double mean_abs_log = 0;         ///< mean |ln(b/a)| over directions and channels
  double rms_log = 0;              ///< root mean square of ln(b/a)
  double max_abs_log = 0;
  double bias_log = 0;             ///< mean ln(b/a)
  double cosine_rms = 0;           ///< sqrt(mean (cos_i cos_o (b - a))^2) relative to sqrt(mean (cos_i cos_o a)^2), solid-angle weighted
  double delta_e_mean = 0;         ///< CIEDE2000 of the lit sphere, see render_lit_sphere, mean over its pixels
  double delta_e_p95 = 0;          ///< 95th percentile
  double scale = 1;                ///< factor applied to B (CompareOptions::scale)
};

BrdfDifference compare(const Brdf& a, const Brdf& b, const CompareOptions& options = {});

/// Linear-RGB picture of a sphere, orthographic, row-major from the top left, NaN-free; `covered` false outside the sphere.
struct SphereImage {
  int size = 0;
  std::vector<glm::vec3> radiance;  ///< reflected radiance under unit-irradiance lights
  std::vector<bool> covered;        ///< pixel on the sphere and BRDF defined there
};

/// Sphere under directional lights of irradiance pi each (a white Lambertian facing one shows radiance 1).
/// `light_directions`: unit, frame x right, y up, z towards the viewer; default: key light at 30 deg right, 30 deg up.
SphereImage render_lit_sphere(const Brdf& brdf, int size, const std::vector<glm::dvec3>& light_directions = {});

}  // namespace lacquer::brdf
