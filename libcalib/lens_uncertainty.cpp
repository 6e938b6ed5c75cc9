#include "libcalib/lens_uncertainty.h"

#include <cmath>

namespace lacquer::calib {

LensUncertainty::LensUncertainty(const LensProblem& problem, const LensFreedom& freedom, double sigma_px)
    : problem_(problem), information_(lens_information(problem, freedom)), covariance_(sandwich(information_.all, information_.corners)) {
  covariance_.scale(sigma_px * sigma_px);
}

glm::dmat2 LensUncertainty::of_pixel(const glm::dvec3& p_cam, bool at_infinity) const {
  auto [x, y] = pixel_gradient(problem_, information_, p_cam, at_infinity);
  const double xx = covariance_.quadratic_form(0, x), yy = covariance_.quadratic_form(0, y);
  for (std::size_t i = 0; i < x.size(); ++i) x[i] += y[i];
  const double xy = 0.5 * (covariance_.quadratic_form(0, x) - xx - yy);
  return {xx, xy, xy, yy};
}

std::vector<double> LensUncertainty::of_intrinsics() const {
  const std::size_t n = problem_.intrinsics.size(), first = information_.first_intrinsic;
  std::vector<double> covariance(n * n);
  for (std::size_t i = 0; i < information_.n_intrinsics; ++i)
    for (std::size_t j = 0; j < information_.n_intrinsics; ++j)
      covariance[(first + i) * n + first + j] = covariance_(i, j) * information_.scale[i] * information_.scale[j];
  return covariance;
}

std::array<double, 2> LensUncertainty::warp_sigma() const {
  const std::size_t n = information_.scale.size();
  std::array<double, 2> sigma{};
  for (std::size_t k = 0; k < 2; ++k) sigma[k] = information_.scale[n - 2 + k] * std::sqrt(covariance_(n - 2 + k, n - 2 + k));
  return sigma;
}

double worst_sigma(const glm::dmat2& c) {
  const double mean = 0.5 * (c[0][0] + c[1][1]), half = 0.5 * (c[0][0] - c[1][1]);
  return std::sqrt(std::max(0.0, mean + std::sqrt(half * half + c[0][1] * c[0][1])));
}

}  // namespace lacquer::calib
