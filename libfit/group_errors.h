#pragma once

#include "libbrdf/cook_torrance.h"
#include "libfit/observations.h"

namespace lacquer::fit {

/// Relative error that the cells of one (theta_h, theta_d) share, because the model cannot follow the paint there: what the scatter of the
/// groups' mean residuals has beyond their sigma. Robust (median); 0 where the model fits, up to four times the variance expected.
/// Wants observations weighed with `model` as reference.
double shared_error(const Observations& observations, const brdf::CookTorrance& model);

/// Takes such an error into the weights: however many cells a group has, it says no more than 1 / shared^2. Otherwise the many cells of a
/// paint's base outvote those of its peak wherever the model fits neither.
void limit_groups(Observations& observations, double shared);

/// Sum of 1 / sigma^2 of all values' logarithms: what observations count.
double total_weight(const Observations& observations);

}  // namespace lacquer::fit
