#pragma once

#include <cmath>

namespace lacquer::fit {

/// A number with its first and second derivatives by two variables: the scalar that makes the model's one
/// text, CookTorranceLobe, deliver the Hessian of a lobe by ln(m) and r.
struct SecondOrder {
  double value = 0;
  double d1 = 0, d2 = 0;  ///< by the first and the second variable
  double d11 = 0, d12 = 0, d22 = 0;

  /// The function of this number with that value, slope and curvature.
  SecondOrder chain(double f, double slope, double curvature) const {
    return {f,
            slope * d1,
            slope * d2,
            slope * d11 + curvature * d1 * d1,
            slope * d12 + curvature * d1 * d2,
            slope * d22 + curvature * d2 * d2};
  }
};

inline SecondOrder operator+(const SecondOrder& a, const SecondOrder& b) {
  return {a.value + b.value, a.d1 + b.d1, a.d2 + b.d2, a.d11 + b.d11, a.d12 + b.d12, a.d22 + b.d22};
}
inline SecondOrder operator+(SecondOrder a, double b) {
  a.value += b;
  return a;
}
inline SecondOrder operator*(const SecondOrder& a, double b) { return a.chain(a.value * b, b, 0); }
inline SecondOrder operator*(double a, const SecondOrder& b) { return b * a; }
inline SecondOrder operator*(const SecondOrder& a, const SecondOrder& b) {
  return {a.value * b.value,
          a.d1 * b.value + a.value * b.d1,
          a.d2 * b.value + a.value * b.d2,
          a.d11 * b.value + 2 * a.d1 * b.d1 + a.value * b.d11,
          a.d12 * b.value + a.d1 * b.d2 + a.d2 * b.d1 + a.value * b.d12,
          a.d22 * b.value + 2 * a.d2 * b.d2 + a.value * b.d22};
}
inline SecondOrder operator/(double a, const SecondOrder& b) {
  const double inverse = 1 / b.value;
  return b.chain(a * inverse, -a * inverse * inverse, 2 * a * inverse * inverse * inverse);
}
inline SecondOrder sqrt(const SecondOrder& a) {
  const double root = std::sqrt(a.value);
  return a.chain(root, 0.5 / root, -0.25 / (root * a.value));
}
inline SecondOrder exp(const SecondOrder& a) {
  const double e = std::exp(a.value);
  return a.chain(e, e, e);
}

}  // namespace lacquer::fit
