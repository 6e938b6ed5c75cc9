#pragma once

#include "libcalib/drift.h"

namespace lacquer::calib {

/// Relative to the first point. Points must be ascending in time; none: {1, 0}.
DriftValue evaluate_drift(const LightDrift& drift, double time_s);

/// P(F > f) of Fisher's distribution with d1 and d2 degrees of freedom (need not be whole), f >= 0. Absolute error < 1e-10.
double f_tail(double f, double d1, double d2);

}  // namespace lacquer::calib
