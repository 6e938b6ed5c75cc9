#include "libfit/comparison.h"

#include <algorithm>
#include <cmath>

namespace lacquer::fit {

namespace {

/// Below this many sigmas a value is compared linearly: at 5 sigma the logarithm is still biased by 2 %
/// before, 0.1 % after correction.
constexpr double weak_signal = 5.0;

}  // namespace

Comparison comparison(double mean, double variance, double signal, double model_sigma) {
  const double noise = std::sqrt(variance);
  const auto hypotenuse = [](double a, double b) { return std::sqrt(a * a + b * b); };  // neither overflows nor vanishes: floats
  // The mean too must be clear of zero, whatever the reference says: its logarithm is taken.
  if (mean > noise && signal > weak_signal * noise) {
    // E[ln(true + noise)] = ln(true) - variance / (2 true^2): the target is raised by that much.
    const double relative = noise / signal, bias = variance / (mean * mean) / 2;
    const double factor = bias < 0.01 ? 1 + bias * (1 + bias / 2 * (1 + bias / 3)) : std::exp(bias);  // to 4e-10: floats
    return {static_cast<float>(mean * factor), static_cast<float>(1 / hypotenuse(relative, model_sigma))};
  }
  return {static_cast<float>(mean), static_cast<float>(-1 / hypotenuse(noise, model_sigma * std::max(signal, mean)))};
}

Comparison comparison_with_bound(double bound, double variance, double model_sigma) {
  return {static_cast<float>(-bound), static_cast<float>(1 / std::sqrt(variance / (bound * bound) + model_sigma * model_sigma))};
}

}  // namespace lacquer::fit
