#pragma once

#include <glm/mat2x2.hpp>

#include "libcalib/lens_problem.h"

namespace lacquer::calib {

/// How far noise of the corners moves a solved lens: covariance of the state sigma^2 (J'J)^-1 J'J_corners (J'J)^-1, and of pixels through it.
class LensUncertainty {
 public:
  /// At the solution `problem`; `sigma_px`: of one coordinate of a corner.
  LensUncertainty(const LensProblem& problem, const LensFreedom& freedom, double sigma_px);

  /// Covariance of the pixel of a fixed point (see pixel_gradient), pixels squared.
  glm::dmat2 of_pixel(const glm::dvec3& p_cam, bool at_infinity) const;
  /// Of the intrinsics, row-major, those that were held have none.
  std::vector<double> of_intrinsics() const;
  /// Of the numbers in the state from its end backwards: the warp's.
  std::array<double, 2> warp_sigma() const;

 private:
  const LensProblem problem_;
  LensInformation information_;
  SymmetricMatrix covariance_;  ///< of the scaled state
};

/// Largest standard deviation of any direction.
double worst_sigma(const glm::dmat2& covariance);

}  // namespace lacquer::calib
