#pragma once

#include "libbrdf/cook_torrance.h"
#include "libfit/observations.h"

namespace lacquer::fit {

/// |ln(model / mean)| over values with a positive mean.
struct LogErrors {
  double mean = 0, rms = 0;
};
LogErrors log_errors(const Observations& observations, const brdf::CookTorrance& model);

/// mean |ln(a / b)| over all cells and channels of the observations.
double mean_abs_log_ratio(const Observations& observations, const brdf::CookTorrance& a, const brdf::CookTorrance& b);

}  // namespace lacquer::fit
