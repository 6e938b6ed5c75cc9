#pragma once

#include <glm/vec2.hpp>
#include <glm/vec4.hpp>
#include <vector>

namespace lacquer::acquire::sim {

/// Node of an integration rule whose weights sum to 1: the sum over weight * f(at) is the mean of f.
struct PlaneNode {
  glm::dvec2 at;
  double weight;
};

/// Mean over the square [-1/2, 1/2]^2: Gauss-Legendre, n x n nodes, exact for polynomials of degree 2n - 1 in x and in y.
std::vector<PlaneNode> square_rule(int n);

/// Mean over the unit disc: Gauss-Legendre in r^2 with `n_radii` nodes times `n_angles` equidistant angles per ring; exact for
/// polynomials in x, y of total degree < min(n_angles, 4 n_radii).
std::vector<PlaneNode> disc_rule(int n_radii, int n_angles);

/// Point `index` of a four-dimensional low-discrepancy sequence (Kronecker sequence of the powers of the generalised golden ratio,
/// M. Roberts 2018, "R4"), shifted modulo 1 by `shift`; in [0, 1)^4.
glm::dvec4 low_discrepancy_point(int index, const glm::dvec4& shift);

/// Point of the unit disc for a point of the unit square, area-preserving.
glm::dvec2 disc_from_square(const glm::dvec2& square);

}  // namespace lacquer::acquire::sim
