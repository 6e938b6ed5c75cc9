#pragma once

#include <array>
#include <vector>

/// Profile of a lit limb across the silhouette. Internal to sphere_outline.cpp.
namespace lacquer::calib {

struct LimbValue {
  double distance;  ///< from the silhouette, pixels, > 0 outside
  double radiance, variance;
};

/// Mean of 1, sqrt(depth), depth inside the silhouette over a Gaussian, 0 outside; tabulated.
class BlurredLimb {
 public:
  /// `sigma`: pixels, > 0, lens and pixel together. `deepest`: pixels inside the silhouette up to which it will be asked for.
  BlurredLimb(double sigma, double deepest);
  std::array<double, 3> at(double distance) const;
  double sigma() const { return sigma_; }
  /// The integral itself.
  static std::array<double, 3> integrate(double distance, double sigma);

 private:
  double sigma_, deepest_;
  std::vector<std::array<double, 3>> table_;
};

struct LimbFit {
  double shift = 0;    ///< of the silhouette, pixels outwards
  double sigma = 0;    ///< from the curvature of the cost, scaled by the residuals where they exceed their variances
  double cost = 0;     ///< squared residuals over variances
  double reduced = 1;  ///< cost per degree of freedom
  bool good = false;
};

/// Least squares of background + a + b sqrt(depth) + c depth for the shift of the silhouette, within +-`reach` pixels.
LimbFit fit_limb(const std::vector<LimbValue>& values, const BlurredLimb& limb, double reach);

}  // namespace lacquer::calib
