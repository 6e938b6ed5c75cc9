#pragma once

#include <cstddef>
#include <glm/vec2.hpp>
#include <optional>
#include <span>
#include <vector>

namespace lacquer::brdf {

/// Linear interpolation (1 - weight) * v[first] + weight * v[second].
struct Blend {
  std::size_t first = 0;
  std::size_t second = 0;
  double weight = 0;  ///< [0, 1]
};

/// Where `x` lies among ascending nodes (at least one); constant beyond the first and the last.
Blend blend_between(std::span<const float> nodes, double x);

/// Integral of a bilinear function over its ny x nx nodes, in units of a patch.
double bilinear_integral(std::span<const float> values, std::size_t nx, std::size_t ny);

/// Slices of nx x ny values on the unit square, x fastest; nodes at j / (n - 1), both ends included, bilinear between them.
class SquareGrid {
 public:
  /// `values`: n_slices * ny * nx, nx and ny at least 2.
  SquareGrid(std::vector<float> values, std::size_t nx, std::size_t ny);

  /// At `u` in [0, 1]^2, interpolated linearly between two slices.
  double value(const glm::dvec2& u, const Blend& slices = {}) const;

 private:
  std::vector<float> values_;
  std::size_t nx_, ny_;
};

/// The warp from microfacet normals to the square on which an RGL file stores its values: the cumulative distribution of the
/// density of visible normals, first over rows (u.y), then within the row (u.x). Dupuy and Jakob 2018, section 4; densities,
/// normalised slice by slice, and their cumulative sums are interpolated linearly between incident angles, as in RGL's
/// reference loader (powitacq_rgb, Marginal2D::invert).
class VisibleNormalWarp {
 public:
  /// `density`: n_slices * ny * nx, all >= 0, any scale. nullopt: a slice is zero everywhere.
  static std::optional<VisibleNormalWarp> create(std::span<const float> density, std::size_t nx, std::size_t ny);

  /// Warped position in [0, 1]^2 of `u` in [0, 1]^2; nullopt where the density of the whole row is 0.
  std::optional<glm::dvec2> invert(const glm::dvec2& u, const Blend& slices) const;

  /// The inverse of invert() on one slice: the position `u` in [0, 1]^2 whose warped position is `s`.
  glm::dvec2 sample(const glm::dvec2& s, std::size_t slice) const;

 private:
  VisibleNormalWarp(std::size_t nx, std::size_t ny) : nx_(nx), ny_(ny) {}

  std::size_t nx_, ny_;
  std::vector<double> density_;      ///< per slice: ny * nx; the integral over the square in patch units is 1
  std::vector<double> conditional_;  ///< per slice: ny * nx, integral of the row from 0 to the node
  std::vector<double> marginal_;     ///< per slice: ny, integral of the rows from 0 to the node, last is 1
};

}  // namespace lacquer::brdf
