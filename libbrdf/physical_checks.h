#pragma once

#include <array>
#include <cstddef>
#include <glm/vec3.hpp>
#include <vector>

#include "libbrdf/brdf.h"
#include "libbrdf/table.h"

namespace lacquer::brdf {

struct CheckOptions {
  double max_theta = 1.3962634015954636;  ///< radians, 80 deg: directions further from the normal are left out of reciprocity
  std::vector<double> theta_i = {};       ///< radians, of the reflectances; empty: 0, 10, ... 80 deg
  int resolution = 180;                   ///< steps of theta_h, and twice as many of phi_h over the whole turn, of the reflectances' integral
  void validate() const;                  ///< throws Error{usage} naming the field
};

/// |ln(a / b)| over pairs of directions that physics says are equal.
struct Asymmetry {
  std::size_t n = 0;  ///< direction-channels compared; both values positive
  double mean_abs_log = 0, median_abs_log = 0, p95_abs_log = 0;
};

/// Share of the light from `theta_i` that is reflected, R G B: integral of f_r cos(theta_o) over the hemisphere.
struct Reflectance {
  double theta_i = 0;
  glm::dvec3 value{0.0};
  glm::dvec3 sigma{0.0};   ///< from the table's variances (cells independent) and its scale, and the integral's own error
  double undefined = 0;    ///< share of the cosine-weighted hemisphere where the BRDF says nothing; it counts as 0 there
  bool conserves_energy() const;  ///< no channel is above 1 by more than 2 sigma
};

struct PhysicalChecks {
  Asymmetry reciprocity;  ///< f(wi, wo) against f(wo, wi); exact for tables over (theta_h, theta_d, phi_d), which cannot tell them apart
  Asymmetry mirror;       ///< phi_d against -phi_d: what a handed paint, or a measurement of it, would show
  std::size_t n_directions = 0, n_negative = 0, n_zero = 0, n_undefined = 0;  ///< direction-channels; undefined: holes
  double most_negative = 0;  ///< 1/sr
  std::vector<Reflectance> reflectances;
};

/// Directions are the half-angle table's cells within max_theta. The reflectance integrates over half vectors, whose grid is dense where a
/// clear coat's peak is: dwo = 4 (wi.h) dwh, theta_h as in the table; its error is taken from a grid of half the resolution.
PhysicalChecks check_physics(const Brdf& brdf, const CheckOptions& options = {});

/// Free repeatability check of a measured table: cells at phi_d and pi - phi_d were seen by other pixels under other lights, and are equal for
/// an isotropic paint. Pairs of measured cells whose neighbours along each axis are measured too, all above five sigma: the local gradient moves the two
/// values to the same place, because the samples of the two cells lie at slightly different ones.
struct MirrorRepeatability {
  std::size_t n_pairs = 0;
  double bias_log = 0;       ///< median of ln(f(phi_d) / f(pi - phi_d)), phi_d < 90 deg
  double scatter_log = 0;    ///< median of its size / 0.6745: what would be sigma if it were Gaussian
  double expected_log = 0;   ///< median of the sigma that the variances say
};
MirrorRepeatability mirror_repeatability(const TableChannel& channel);

/// A pixel's footprint spreads the half vector, in theta_h, by more than the width of its cell (sigma against width): the cell's samples are
/// no finer than several cells. Narrow cells at the peak often are.
bool smaller_than_footprint(const TableChannel& channel, std::size_t cell);

}  // namespace lacquer::brdf
