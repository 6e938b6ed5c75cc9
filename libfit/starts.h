#pragma once

#include <cstddef>
#include <vector>

#include "libbrdf/cook_torrance.h"
#include "libfit/observations.h"

namespace lacquer::fit {

/// Starting models without luck, best first, at most `count`, apart from each other in m.
///
/// For given m the model is linear with non-negative coefficients: ks (r + (1 - r) s) = (ks r) 1 + (ks (1 -
/// r)) s with Schlick's weight s, so every lobe is two columns, lobe(m, r = 1) and lobe(m, r = 0). The Gram
/// matrix of all columns on a grid of m is summed once; each choice of `n_lobes` grid values is then a tiny
/// non-negative least-squares problem per channel. No random numbers; m in [min_m, 1].
std::vector<brdf::CookTorrance> scan_for_starts(const Observations& observations, int n_lobes,
                                                std::size_t count, double min_m);

}  // namespace lacquer::fit
