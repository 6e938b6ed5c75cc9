#include "libbrdf/color.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace lacquer::brdf {

namespace {

constexpr double pi = std::numbers::pi;

constexpr double radians(double degrees) { return degrees * pi / 180; }

/// The cube root of CIE 15 with its linear continuation near black.
double lab_f(double t) {
  constexpr double epsilon = 216.0 / 24389, kappa = 24389.0 / 27;
  return t > epsilon ? std::cbrt(t) : (kappa * t + 16) / 116;
}

double pow7(double x) {
  const double x2 = x * x;
  return x2 * x2 * x2 * x;
}

/// Hue angle in [0, 2 pi); 0 for a colour without hue.
double hue(double a, double b) {
  if (a == 0 && b == 0) return 0;
  const double h = std::atan2(b, a);
  return h < 0 ? h + 2 * pi : h;
}

struct HueDifference {
  double difference;  ///< h2 - h1 on the shorter arc, radians
  double mean;        ///< in the middle of the shorter arc, radians
};

/// Sharma et al. 2005, Eq. 10 and 14, for two colours that both have a hue.
HueDifference compare_hues(double h1, double h2) {
  // Opposite hues (exactly 180 deg) belong to the first branch; the tolerance keeps the rounding of atan2
  // from deciding it.
  constexpr double half_turn = pi * (1 + 1e-12);
  const double difference = h2 - h1, sum = h1 + h2;
  if (std::abs(difference) <= half_turn) return {difference, sum / 2};
  return {difference > 0 ? difference - 2 * pi : difference + 2 * pi,
          sum < 2 * pi ? sum / 2 + pi : sum / 2 - pi};
}

}  // namespace

glm::dvec3 xyz_from_linear_srgb(const glm::dvec3& rgb) {
  // The exact rational solution for the chromaticities of IEC 61966-2-1 (its printed 4-digit matrix is this,
  // rounded).
  return {506752.0 / 1228815 * rgb.r + 87881.0 / 245763 * rgb.g + 12673.0 / 70218 * rgb.b,
          87098.0 / 409605 * rgb.r + 175762.0 / 245763 * rgb.g + 12673.0 / 175545 * rgb.b,
          7918.0 / 409605 * rgb.r + 87881.0 / 737289 * rgb.g + 1001167.0 / 1053270 * rgb.b};
}

glm::dvec3 lab_from_linear_srgb(const glm::dvec3& rgb) {
  const glm::dvec3 white(3127.0 / 3290, 1.0, 3583.0 / 3290);
  const glm::dvec3 xyz = xyz_from_linear_srgb(rgb) / white;
  const double fx = lab_f(xyz.x), fy = lab_f(xyz.y), fz = lab_f(xyz.z);
  return {116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)};
}

double delta_e_2000(const glm::dvec3& lab_a, const glm::dvec3& lab_b) {
  // Symbols as in Sharma et al. 2005, Eq. 2 to 22; indices 1 and 2 are a and b, primes left out after a'.
  const double L1 = lab_a.x, b1 = lab_a.z, L2 = lab_b.x, b2 = lab_b.z;
  const double C7_ab = pow7((std::hypot(lab_a.y, b1) + std::hypot(lab_b.y, b2)) / 2);
  const double G = 0.5 * (1 - std::sqrt(C7_ab / (C7_ab + pow7(25))));
  const double a1 = (1 + G) * lab_a.y, a2 = (1 + G) * lab_b.y;
  const double C1 = std::hypot(a1, b1), C2 = std::hypot(a2, b2);
  const double h1 = hue(a1, b1), h2 = hue(a2, b2);
  const HueDifference h = C1 * C2 == 0 ? HueDifference{0.0, h1 + h2} : compare_hues(h1, h2);

  const double dL = L2 - L1, dC = C2 - C1, dH = 2 * std::sqrt(C1 * C2) * std::sin(h.difference / 2);
  const double L = (L1 + L2) / 2, C = (C1 + C2) / 2;
  const double T = 1 - 0.17 * std::cos(h.mean - radians(30)) + 0.24 * std::cos(2 * h.mean) +
                   0.32 * std::cos(3 * h.mean + radians(6)) - 0.20 * std::cos(4 * h.mean - radians(63));
  const double turn = (h.mean - radians(275)) / radians(25);
  const double rotation = radians(30) * std::exp(-turn * turn);
  const double R_C = 2 * std::sqrt(pow7(C) / (pow7(C) + pow7(25)));
  const double L50 = (L - 50) * (L - 50);
  const double l = dL / (1 + 0.015 * L50 / std::sqrt(20 + L50));
  const double c = dC / (1 + 0.045 * C);
  const double hh = dH / (1 + 0.015 * C * T);
  // R_T = -sin(2 rotation) R_C > -2, so the quadratic form is not negative but for rounding.
  return std::sqrt(std::max(0.0, l * l + c * c + hh * hh - std::sin(2 * rotation) * R_C * c * hh));
}

}  // namespace lacquer::brdf
