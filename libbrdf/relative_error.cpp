#include "libbrdf/relative_error.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>

namespace lacquer::brdf {

namespace {

constexpr double pi = std::numbers::pi;
constexpr int n_directions = 30000;

/// Generalised golden ratio sequence in three dimensions (Roberts 2018): 1 / g, 1 / g^2, 1 / g^3 with g^4 = g + 1.
glm::dvec3 low_discrepancy(int i) {
  const double g = 1.2207440846057596;
  const auto fraction = [&](double step) {
    const double x = 0.5 + step * (i + 1);
    return x - std::floor(x);
  };
  return {fraction(1 / g), fraction(1 / (g * g)), fraction(1 / (g * g * g))};
}

RelativeError over(const Brdf& a, const Brdf& b, const std::function<Directions(const glm::dvec3&)>& directions_of) {
  RelativeError result;
  double sum = 0;
  for (int i = 0; i < n_directions; ++i) {
    const Directions d = directions_of(low_discrepancy(i));
    const auto f_a = a.value(d), f_b = b.value(d);
    if (!f_a) continue;
    for (int c = 0; c < 3; ++c) {
      if (!((*f_a)[c] > 0)) continue;
      if (!f_b) {
        ++result.n_lost;
        continue;
      }
      const double error = std::abs((*f_b)[c] / (*f_a)[c] - 1);
      sum += error;
      result.max = std::max(result.max, error);
      ++result.n;
    }
  }
  if (result.n) result.mean = sum / static_cast<double>(result.n);
  return result;
}

}  // namespace

RelativeError relative_error(const Brdf& a, const Brdf& b, double max_theta) {
  return over(a, b, [&](const glm::dvec3& x) {
    return Directions{direction(max_theta * x.x, 0), direction(max_theta * x.y, 2 * pi * x.z)};
  });
}

RelativeError relative_error_near_specular(const Brdf& a, const Brdf& b, double max_theta) {
  constexpr double width = 3 * pi / 180;
  return over(a, b, [&](const glm::dvec3& x) {
    return directions({width * x.x, std::max(max_theta - width, 0.0) * x.y, pi * (2 * x.z - 1)});
  });
}

}  // namespace lacquer::brdf
