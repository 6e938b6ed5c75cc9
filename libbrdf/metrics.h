#pragma once

#include <array>
#include <cstddef>
#include <glm/vec3.hpp>
#include <numbers>
#include <optional>
#include <vector>

#include "libbrdf/brdf.h"

namespace lacquer::brdf {

/// Which directions two BRDFs are compared at.
struct CompareOptions {
  /// Radians, (0, pi/2]; both directions at most this far from the normal. 80 deg.
  double max_theta = 80 * std::numbers::pi / 180;
  int phi_d_step = 2;  ///< every n-th phi_d cell of the table's grid is a direction; 1 (all) to 180
  /// true: B is first multiplied by the one factor that makes the mean log ratio 0 (relative measurements).
  bool scale = false;
  void validate() const;  ///< throws Error{usage} naming the field
};

/// Difference of B from A.
///
/// Directions of the log ratios and of cosine_rms: centres of the half-angle table's cells within max_theta,
/// where both BRDFs say something. The log ratios count every cell and channel alike, as the fit's objective
/// in Günther et al. 2005 does; the grid is dense at the peak, so the highlight weighs far more than its
/// solid angle. cosine_rms weighs a cell by its solid angles: with wi as (theta_d, phi_d) about h, dwi dwo =
/// 4 cos(theta_d) dwi dwh = 4 cos(theta_d) sin(theta_d) sin(theta_h) dtheta_h dtheta_d dphi_d dphi_h,
/// integrated exactly over the cell's edges.
///
/// delta_e: the sphere of render_lit_sphere, 128 pixels wide, once under each light of `lit_sphere_lights()`,
/// shown on an ideal sRGB display whose white is radiance 1, i.e. a white Lambertian facing the light: values
/// above 1 and below 0 are clipped as a display does. CIEDE2000 of each pixel of the three pictures where
/// both directions are within max_theta and both BRDFs say something.
struct BrdfDifference {
  std::size_t n_directions = 0;   ///< compared
  std::size_t n_undefined = 0;    ///< left out: one of the two says nothing there
  std::size_t n_nonpositive = 0;  ///< direction-channels left out of the log ratio: a value <= 0
  double mean_abs_log = 0;        ///< mean |ln(b/a)| over directions and channels
  double rms_log = 0;             ///< root mean square of ln(b/a)
  double max_abs_log = 0;
  double bias_log = 0;  ///< mean ln(b/a)
  /// sqrt(mean (cos_i cos_o (b - a))^2) / sqrt(mean (cos_i cos_o a)^2), solid-angle weighted, all channels.
  double cosine_rms = 0;
  /// sqrt(mean (cbrt(cos_i b) - cbrt(cos_i a))^2), solid-angle weighted, all channels, sr^(-1/3): close to what eyes call different, because
  /// a cube root treats highlight and base nearly alike (Fores, Ferwerda, Gu 2012).
  double cube_root_rms = 0;
  std::size_t n_pixels = 0;  ///< of the lit spheres; 0: none could be compared, delta_e means nothing
  double delta_e_mean = 0;   ///< CIEDE2000 of the lit spheres, mean over their pixels
  double delta_e_p95 = 0;    ///< 95th percentile (nearest rank)
  double scale = 1;          ///< factor applied to B (CompareOptions::scale): exp(-mean ln(b/a))
};

/// Compares B with A. Identical BRDFs give exactly 0; the log measures but for the sign of bias_log do not
/// change when A and B are swapped. The result does not depend on the number of threads. Throws Error{input}
/// when there is no common direction, no direction with both values positive, or a value that is not finite.
BrdfDifference compare(const Brdf& a, const Brdf& b, const CompareOptions& options = {});

/// CIEDE2000 of the lit spheres alone, as in BrdfDifference; n_pixels 0: nothing could be compared. `scale`: on B.
struct LitSphereDifference {
  std::size_t n_pixels = 0;
  double mean = 0, p95 = 0;
};
LitSphereDifference compare_lit_spheres(const Brdf& a, const Brdf& b, const CompareOptions& options = {}, double scale = 1);

/// The three lights of delta_e: 20, 50 and 80 deg from the view direction (highlight near the centre,
/// half-way, at grazing), at an azimuth of 30 deg, which keeps the pixel rows from repeating each other by
/// mirror symmetry.
std::array<glm::dvec3, 3> lit_sphere_lights();

/// Linear-RGB picture of a sphere, orthographic, row-major from the top left, NaN-free; `covered` false
/// outside the sphere.
struct SphereImage {
  int size = 0;
  std::vector<glm::vec3> radiance;  ///< reflected radiance; 0 where not covered
  std::vector<bool> covered;  ///< the pixel's centre is on the sphere and the BRDF is defined there for every
                              ///< light above the horizon
};

/// Unit normal (x right, y up, z towards the viewer) of the sphere at the centre of pixel (column, row) of a
/// picture `size` wide that the sphere just fills; nullopt: the centre is not on the sphere.
std::optional<glm::dvec3> sphere_normal(int size, int column, int row);

/// Sphere under directional lights of irradiance pi each (a white Lambertian facing one shows radiance 1),
/// one sample at each pixel's centre. `light_directions`: unit, frame x right, y up, z towards the viewer;
/// default: key light at 30 deg right, 30 deg up. Throws Error{usage} for a size outside 1..16384 or a
/// direction that is not a unit vector, Error{input} for a value that is not finite.
SphereImage render_lit_sphere(const Brdf& brdf, int size,
                              const std::vector<glm::dvec3>& light_directions = {});

}  // namespace lacquer::brdf
