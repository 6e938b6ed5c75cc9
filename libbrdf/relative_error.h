#pragma once

#include <cstddef>

#include "libbrdf/brdf.h"

namespace lacquer::brdf {

/// |b / a - 1| of single values, where a BRDF was written to a file and read back.
struct RelativeError {
  std::size_t n = 0;       ///< values compared: directions times channels with a > 0
  std::size_t n_lost = 0;  ///< values where A says something and B does not
  double mean = 0;
  double max = 0;
};

/// All pairs of directions within `max_theta` of the normal, theta_i, theta_o and the azimuth between them uniform (a low-discrepancy
/// sequence, the same for every call).
RelativeError relative_error(const Brdf& a, const Brdf& b, double max_theta);

/// Near the mirror direction: theta_h uniform in 0 to 3 degrees, theta_d up to `max_theta` - 3 degrees, every phi_d. The highlight of
/// a clear coat lies here.
RelativeError relative_error_near_specular(const Brdf& a, const Brdf& b, double max_theta);

}  // namespace lacquer::brdf
