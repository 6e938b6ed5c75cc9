#pragma once

#include <vector>

#include "libfit/fit.h"
#include "libfit/objective.h"
#include "libfit/solver.h"

namespace lacquer::fit {

/// Which parameters get a profile. `misleading`: those to whose error the quadratic form is no guide, because it reaches a bound or, of m,
/// half of its size within 2 sigma.
enum class Profiled { all, misleading };

/// Profile intervals of determined parameters into `result.parameters`: how far one parameter can be moved until the objective,
/// minimised over all others, has risen as far as chance makes it in 68.3 % and 95 % of cases, in units of the parameter's own excess of
/// residuals (Parameter::inflation). Asymmetric where the objective is; ends at a bound that is reached before. `x`: the minimum.
void add_profiles(const Objective& objective, const std::vector<double>& x, const SolverOptions& solver, Profiled which, FitResult& result);

}  // namespace lacquer::fit
