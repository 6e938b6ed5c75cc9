#include "libacquire/sim/quadrature.h"

#include <cmath>
#include <numbers>

namespace lacquer::acquire::sim {

/// Roots of the Legendre polynomial P_n by Newton iteration from Tricomi's approximation (Abramowitz and Stegun 25.4.29).
std::vector<LineNode> line_rule(int n) {
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
    nodes.push_back({0.5 + x / 2, 1 / ((1 - x * x) * derivative * derivative)});
  }
  return nodes;
}

std::vector<PlaneNode> square_rule(int n) {
  const auto line = line_rule(n);
  std::vector<PlaneNode> nodes;
  for (const LineNode& y : line)
    for (const LineNode& x : line) nodes.push_back({{x.at - 0.5, y.at - 0.5}, x.weight * y.weight});
  return nodes;
}

std::vector<PlaneNode> disc_rule(int n_radii, int n_angles) {
  const auto radii = line_rule(n_radii);
  std::vector<PlaneNode> nodes;
  for (int ring = 0; ring < n_radii; ++ring) {
    const LineNode& node = radii[static_cast<std::size_t>(ring)];
    const double radius = std::sqrt(node.at);
    for (int k = 0; k < n_angles; ++k) {
      const double angle = 2 * std::numbers::pi * (k + 0.5 * (ring % 2) + 0.25) / n_angles;
      nodes.push_back({radius * glm::dvec2(std::cos(angle), std::sin(angle)), node.weight / n_angles});
    }
  }
  return nodes;
}

}  // namespace lacquer::acquire::sim
