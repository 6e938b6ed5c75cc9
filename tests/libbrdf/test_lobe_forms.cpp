#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "libbrdf/cook_torrance.h"

/// Forms of a lobe beside the paper's: exact Fresnel reflectance, GGX.
namespace lacquer::brdf {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double degree = pi / 180;

// Glass of index 1.5: by hand from r_s = (cos i - n cos t)/(cos i + n cos t), r_p = (n cos i - cos t)/(n cos i + cos t) and Snell's law.
TEST(Dielectric, IsFresnelsFormulaForBothPolarisations) {
  constexpr double n = 1.5, r0 = 0.04;
  for (const double theta : {0.0, 10.0, 45.0, 56.309932474020215, 80.0, 89.9}) {
    const double i = std::cos(theta * degree), t = std::sqrt(1 - (1 - i * i) / (n * n));
    const double s = (i - n * t) / (i + n * t), p = (n * i - t) / (n * i + t);
    EXPECT_NEAR(dielectric_reflectance(r0, i), (s * s + p * p) / 2, 1e-14) << theta;
  }
  EXPECT_NEAR(dielectric_reflectance(0.0, 0.3), 0, 1e-30);
}

// The plane of slopes holds all facets once: pi / pi * int 1/(m^2 (1 + s^2/m^2)^2) ds = 1.
TEST(Ggx, EveryFacetCountsOnce) {
  for (const double m : {0.02, 0.3, 1.0}) {
    double sum = 0;
    constexpr int n = 20000;
    for (int k = 0; k < n; ++k) {
      // s = m tan(x): equal steps of x reach from the peak far into the tail.
      const double x = (k + 0.5) * pi / 2 / n, s = m * std::tan(x), ds = m / (std::cos(x) * std::cos(x)) * pi / 2 / n;
      const auto c = half_angle_cosines(HalfDiff{std::atan(s), 0, 0});
      const double geometry = geometry_over_cosines(c);
      const CookTorranceLobe<double> lobe{m, 1, Distribution::ggx};
      sum += lobe(c) * pi * std::pow(c.n_dot_h, 4) / geometry * 2 * s * ds;
      EXPECT_NEAR(lobe.log_value(c), std::log(lobe(c)), 1e-12 * std::abs(lobe.log_value(c)) + 1e-12);
    }
    EXPECT_NEAR(sum, 1, 1e-6) << m;
  }
}

// Numerical convolution of the peak with a small Gaussian: 1 - 4 V / m^2 to first order in V.
TEST(Ggx, AFootprintWidensThePeakToFirstOrder) {
  const double m = 0.1, v = 1e-5;
  double blurred = 0;
  constexpr int n = 4000;
  for (int k = 0; k < n; ++k) {
    const double s2 = std::pow((k + 0.5) * 8 * std::sqrt(v) / n, 2), ds = 8 * std::sqrt(v) / n;
    blurred += std::exp(-s2 / (2 * v)) / v * std::sqrt(s2) * ds / std::pow(1 + s2 / (m * m), 2);
  }
  auto c = half_angle_cosines(HalfDiff{0, 0, 0});
  const CookTorranceLobe<double> lobe{m, 0.5, Distribution::ggx};
  const double point = lobe(c);
  c.footprint = {v, v, 0};
  EXPECT_NEAR(lobe(c) / point, blurred, 10 * std::pow(v / (m * m), 2));
}

}  // namespace
}  // namespace lacquer::brdf
