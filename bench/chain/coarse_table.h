#pragma once

#include "libbrdf/table.h"

namespace lacquer::bench {

/// What a table with cells `n` times as wide in theta_h (in cells), theta_d and phi_d would hold: measured cells of a group pooled into one,
/// weighted by their samples, at their mean coordinates, with the spread of tan(theta_h) within the group added to the footprint.
brdf::HalfAngleTable coarser(const brdf::HalfAngleTable& table, int n);

}  // namespace lacquer::bench
