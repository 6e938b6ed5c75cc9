#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "libcalib/geometry_solver.h"
#include "libcalib/paint_spline.h"
#include "libcalib/response_algebra.h"

/// Linear algebra of the light on the paint: the paint, a factor of each view and the error of its turntable angle are eliminated from the
/// normal equations. Internal to paint_evidence.cpp.
namespace lacquer::calib {

using Columns = std::vector<std::vector<double>>;

/// Normal equations of a piece of the samples: B are the paint's splines, d the columns (derivatives by unknowns and nuisances), e what
/// samples of a view share (1 for its factor, the derivative by the turntable's angle), r the residuals, W the weights. "By shared error":
/// the factors of all views, then the angles.
struct PaintSums {
  SplineMatrix paint;                               ///< B' W B
  std::vector<double> paint_residual = std::vector<double>(PaintSpline::size);  ///< B' W r
  Columns cross;                                    ///< by column: B' W d
  SymmetricMatrix columns;                          ///< d' W d
  std::vector<double> residual;                     ///< d' W r
  Columns view_cross;                               ///< by shared error: B' W e
  std::vector<std::array<double, 3>> view_weight;   ///< by view: e' W e, of factor, factor and angle, angle
  std::vector<double> view_residual;                ///< by shared error: e' W r
  Columns view_columns;                             ///< by column: e' W d, by shared error

  PaintSums(std::size_t n_columns, std::size_t n_views);
  void add(const PaintSpline::Basis& b, const std::vector<double>& d, std::size_t view, double by_angle, double weight, double residual);
  /// What else says where the turntable stands in a view: residual = d . change of the columns + error of the angle, radians.
  void add_track(const std::vector<double>& d, std::size_t view, double weight, double residual);
  void add(const PaintSums& other);
};

/// The paint is free but for its smoothness; angles are normal about what was read back; the factors of the views are normal about 1 with a
/// common sigma that the data tell (expectation maximisation of the marginal likelihood).
class PaintElimination {
 public:
  /// `prior_sigma` of the columns, `angle_sigma` radians.
  PaintElimination(PaintSums sums, double smoothness, const std::vector<double>& prior_sigma, double angle_sigma);

  const SymmetricMatrix& information() const { return s_; }     ///< of the columns
  const std::vector<double>& gradient() const { return g_; }
  double view_sigma() const { return view_sigma_; }             ///< relative

  /// A sample with paint and view taken out of its columns `d`, all in place; what remains of the residual with all that was found.
  double project(const PaintSpline::Basis& b, std::size_t view, double by_angle, double residual, std::vector<double>& d) const;
  double project_track(std::size_t view, double residual, std::vector<double>& d) const;

 private:
  void find_view_sigma(const SymmetricMatrix& views, const Columns& cross, const std::vector<double>& view_gradient, const std::vector<double>& prior_sigma, double angle_sigma);

  std::size_t n_views_ = 0;
  SymmetricMatrix s_;
  std::vector<double> g_;
  double view_sigma_ = 0;
  Columns taken_;                   ///< by column: of the paint's coefficients
  std::vector<double> paint_step_;
  Columns view_taken_;              ///< by column: of the shared errors
  std::vector<double> view_step_, step_;
};

/// Rows and offsets about `at` (the unknowns' values) of what the elimination says of the unknowns, which are the first of its columns: with the
/// weight that `scatter`, the covariance of its gradient, supports (S M^-1 S), and without the nuisances, which are the other columns and have
/// `nuisance_sigma`.
void add_rows(const PaintElimination& elimination, const SymmetricMatrix& scatter, const std::vector<double>& nuisance_sigma, const std::vector<double>& at,
              GeometryEvidence& evidence);

}  // namespace lacquer::calib
