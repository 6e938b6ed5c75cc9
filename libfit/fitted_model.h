#pragma once

#include <filesystem>
#include <vector>

#include "libbrdf/cook_torrance.h"
#include "libfit/fit.h"

namespace lacquer::fit {

/// What of a fit is needed to propagate its errors.
struct FittedModel {
  brdf::CookTorrance model;
  std::vector<Parameter> parameters;
  std::vector<double> covariance;  ///< as FitResult::covariance
};

/// Model, parameters and covariance of a fit.json. Throws Error{file} naming file and field: a model alone has no covariance.
FittedModel read_fit(const std::filesystem::path& file);

/// Standard error of f_r, 1/sr, R G B, at these cosines: the covariance carried through the model to first order. Parameters that are not
/// determined count as known.
glm::dvec3 value_sigma(const FittedModel& fit, const brdf::HalfAngleCosines<double>& cosines);

/// Models drawn from the fit's normal distribution, each parameter put back to its bounds; always the same ones.
std::vector<brdf::CookTorrance> draw_models(const FittedModel& fit, int count);

}  // namespace lacquer::fit
