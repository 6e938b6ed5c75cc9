#pragma once

#include <cstdint>
#include <vector>

#include "libbrdf/cook_torrance.h"
#include "libbrdf/table.h"

namespace lacquer::fit {

/// Where a model differs from a table: by theta_h x theta_d cell of the table's grid (row-major, theta_h first), over phi_d and channels.
struct ResidualMap {
  std::vector<double> mean_log;     ///< mean ln(model / mean); 0 where `n` is 0
  std::vector<double> rms_log;      ///< root mean square of the same
  std::vector<std::uint32_t> n;     ///< values
};

/// Over measured cells with a positive mean, both directions' cosines above `min_cosine`.
ResidualMap residual_map(const brdf::HalfAngleTable& table, const brdf::CookTorrance& model, double min_cosine = 0.08715574274765817);

}  // namespace lacquer::fit
