#include "libacquire/sim/quadrature.h"

#include <cmath>
#include <glm/common.hpp>
#include <numbers>

namespace lacquer::acquire::sim {

namespace {

struct LineNode {
  double at;      // in [-1/2, 1/2]
  double weight;  // sums to 1
};

/// Roots of the Legendre polynomial P_n by Newton iteration from Tricomi's approximation (Abramowitz and Stegun 25.4.29).
std::vector<LineNode> gauss_legendre(int n) {
  std::vector<LineNode> nodes;
  for (int i = 1; i <= n; ++i) {
    double x = std::cos(std::numbers::pi * (i - 0.25) / (n + 0.5));
    double derivative = 1;
    for (int iteration = 0; iteration < 20; ++iteration) {
      double p = 1, previous = 0;
      for (int k = 1; k <= n; ++k) {
        const double next = ((2 * k - 1) * x * p - (k - 1) * previous) / k;
        previous = p;
        p = next;
      }
      derivative = n * (x * p - previous) / (x * x - 1);
      const double step = p / derivative;
      x -= step;
      if (std::abs(step) < 1e-15) break;
    }
    nodes.push_back({x / 2, 1 / ((1 - x * x) * derivative * derivative)});
  }
  return nodes;
}

}  // namespace

std::vector<PlaneNode> square_rule(int n) {
  const auto line = gauss_legendre(n);
  std::vector<PlaneNode> nodes;
  for (const LineNode& y : line)
    for (const LineNode& x : line) nodes.push_back({{x.at, y.at}, x.weight * y.weight});
  return nodes;
}

std::vector<PlaneNode> disc_rule(int n_radii, int n_angles) {
  const auto radii = gauss_legendre(n_radii);
  std::vector<PlaneNode> nodes;
  for (int ring = 0; ring < n_radii; ++ring) {
    const LineNode& node = radii[static_cast<std::size_t>(ring)];
    const double radius = std::sqrt(node.at + 0.5);
    for (int k = 0; k < n_angles; ++k) {
      const double angle = 2 * std::numbers::pi * (k + 0.5 * (ring % 2) + 0.25) / n_angles;
      nodes.push_back({radius * glm::dvec2(std::cos(angle), std::sin(angle)), node.weight / n_angles});
    }
  }
  return nodes;
}

glm::dvec4 low_discrepancy_point(int index, const glm::dvec4& shift) {
  constexpr double g = 1.16730397826141868;  // root of x^5 = x + 1
  constexpr double a1 = 1 / g, a2 = a1 / g, a3 = a2 / g, a4 = a3 / g;
  return glm::fract(shift + static_cast<double>(index) * glm::dvec4(a1, a2, a3, a4));
}

glm::dvec2 disc_from_square(const glm::dvec2& square) {
  const double radius = std::sqrt(square.x), angle = 2 * std::numbers::pi * square.y;
  return radius * glm::dvec2(std::cos(angle), std::sin(angle));
}

}  // namespace lacquer::acquire::sim
