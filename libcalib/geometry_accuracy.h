#pragma once

#include <string>
#include <vector>

#include "libcalib/geometry_residuals.h"
#include "libcalib/geometry_solver.h"
#include "libcalib/response_algebra.h"

namespace lacquer::calib {

/// Derivatives of what samples depend on by the unknowns, for a spread of views; each row: one component, by unknown.
struct GeometryEffects {
  std::vector<std::vector<double>> light;     ///< direction from the sphere's centre, 3 rows per view
  std::vector<std::vector<double>> half;      ///< half vector minus normal at a fixed pixel, 3 rows per view
  std::vector<std::vector<double>> distance;  ///< logarithm of the light's distance
};
GeometryEffects geometry_effects(const GeometryResiduals& residuals, const std::vector<double>& x);

/// RMS over the views of a vector of `per_view` components with the given covariance of the unknowns (row-major).
double rms_effect(const std::vector<std::vector<double>>& rows, const std::vector<double>& covariance, double per_view);

/// What the images do not determine, in words: lights without highlights or with too few of them, no silhouette, numbers that
/// contradict the rig file (a wrong radius shows so), and directions of the unknowns in which the images say less than the prior and that move light directions or half vectors noticeably. `information`: with
/// the priors, `from_images`: without.
std::vector<std::string> geometry_warnings(const GeometryResiduals& residuals, const acquire::RigGeometry& nominal, const std::vector<double>& x,
                                           const SymmetricMatrix& information, const SymmetricMatrix& from_images, const GeometryEffects& effects);

}  // namespace lacquer::calib
