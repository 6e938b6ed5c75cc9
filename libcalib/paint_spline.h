#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "libbrdf/directions.h"

/// A paint about which nothing is assumed but that it is isotropic, reciprocal and smooth. Internal to paint_evidence.cpp.
namespace lacquer::calib {

/// ln f as a tensor product of quadratic B-splines over sqrt(theta_h), theta_d and sin^2(phi_d): the last makes it isotropic and
/// reciprocal by construction, the first puts the knots where lobes change fast.
class PaintSpline {
 public:
  /// theta_h in [lowest_theta_h, highest_theta_h], theta_d in [0, highest_theta_d], radians; outside the splines have no meaning.
  PaintSpline(double lowest_theta_h, double highest_theta_h, double highest_theta_d);

  static constexpr std::size_t n_theta_h = 34, n_theta_d = 12, n_phi_d = 6;
  static constexpr std::size_t size = n_theta_h * n_theta_d * n_phi_d;
  static constexpr std::size_t band = 2 * n_theta_d * n_phi_d + 2 * n_phi_d + 2;  ///< coefficients further apart never meet
  static constexpr std::size_t n_met = 27;

  struct Basis {
    std::array<std::size_t, n_met> index;  ///< ascending
    std::array<double, n_met> value;
  };
  bool contains(const brdf::HalfDiff& c) const;
  Basis at(const brdf::HalfDiff& c) const;

 private:
  double lowest_, highest_, root_lowest_, per_root_, per_theta_d_, highest_theta_d_;
};

/// Symmetric positive definite matrix of a PaintSpline's coefficients, of which only a band is not 0.
class SplineMatrix {
 public:
  SplineMatrix() : a_(PaintSpline::size * width) {}
  void add(const PaintSpline::Basis& b, double weight);
  void add(const SplineMatrix& other);
  /// Coefficients without data go on as their neighbours do; where there are data it changes next to nothing.
  void add_smoothness(double weight);
  /// In place, L L^T. Must come before the two below.
  void factor();
  void solve_lower(std::vector<double>& b) const;  ///< L^-1 b, in place
  void solve_upper(std::vector<double>& b) const;  ///< L^-T b, in place

 private:
  static constexpr std::size_t width = PaintSpline::band + 1;
  double& at(std::size_t row, std::size_t column) { return a_[row * width + column + PaintSpline::band - row]; }
  double at(std::size_t row, std::size_t column) const { return a_[row * width + column + PaintSpline::band - row]; }
  std::vector<double> a_;  ///< row by row, columns row - band .. row
};

}  // namespace lacquer::calib
