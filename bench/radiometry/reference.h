#pragma once

#include <span>
#include <vector>

#include "bench/radiometry/stack.h"

namespace lacquer::bench {

struct ReferenceImage {
  std::vector<double> radiance;  ///< linearised DN per second
  std::vector<double> variance;  ///< infinite where no exposure can be used
};

/// Inverse-variance weighting with the KNOWN response and noise, in double, one value after the other, one thread:
///   x = sum(w z) / sum(w t),  w = t / var(x0 t),  var(z) = read^2 + z / gain + slope(z)^2 / 12.
/// Clipped values are left out, and exposures whose predicted value x0 t lies within 3 sigma of the floor of a sensor without black level.
/// x0 is `pilot`, e.g. the truth; empty: sum of the light over sum of the time. Not quite a bound: a clipped value still says "at least".
ReferenceImage merge_reference(const Stack& stack, std::span<const double> pilot);

}  // namespace lacquer::bench
