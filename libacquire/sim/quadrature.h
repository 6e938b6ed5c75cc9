#pragma once

#include <glm/vec2.hpp>
#include <vector>

namespace lacquer::acquire::sim {

/// Node of an integration rule whose weights sum to 1: the sum over weight * f(at) is the mean of f.
struct PlaneNode {
  glm::dvec2 at;
  double weight;
};

struct LineNode {
  double at;
  double weight;
};

/// Mean over [0, 1]: Gauss-Legendre with n nodes, exact for polynomials of degree 2n - 1.
std::vector<LineNode> line_rule(int n);

/// Mean over the square [-1/2, 1/2]^2: Gauss-Legendre, n x n nodes, exact for polynomials of degree 2n - 1 in x and in y.
std::vector<PlaneNode> square_rule(int n);

/// Mean over the unit disc: Gauss-Legendre in r^2 with `n_radii` nodes times `n_angles` equidistant angles per ring; exact for
/// polynomials in x, y of total degree < min(n_angles, 4 n_radii).
std::vector<PlaneNode> disc_rule(int n_radii, int n_angles);

}  // namespace lacquer::acquire::sim
