#pragma once

#include <cstddef>
#include <vector>

#include "libcalib/paint_spline.h"
#include "libcalib/response_algebra.h"

/// Linear algebra of the light on the paint: the paint and a factor of each view are eliminated from the normal equations. Internal to
/// paint_evidence.cpp.
namespace lacquer::calib {

using Columns = std::vector<std::vector<double>>;

/// Normal equations of a piece of the samples: B are the paint's splines, d the columns (derivatives by unknowns and nuisances), e the
/// samples' views, r the residuals, W the weights.
struct PaintSums {
  SplineMatrix paint;                 ///< B' W B
  std::vector<double> paint_residual = std::vector<double>(PaintSpline::size);  ///< B' W r
  Columns cross;                      ///< by column: B' W d
  SymmetricMatrix columns;            ///< d' W d
  std::vector<double> residual;       ///< d' W r
  Columns view_cross;                 ///< by view: B' W e
  std::vector<double> view_weight;    ///< e' W e
  std::vector<double> view_residual;  ///< e' W r
  Columns view_columns;               ///< by column: e' W d

  PaintSums(std::size_t n_columns, std::size_t n_views);
  void add(const PaintSpline::Basis& b, const std::vector<double>& d, std::size_t view, double weight, double residual);
  void add(const PaintSums& other);
};

/// The paint is free but for its smoothness; the factors of the views are normal about 1 with a common sigma that the data tell
/// (expectation maximisation of the marginal likelihood).
class PaintElimination {
 public:
  /// `prior_sigma` of the columns.
  PaintElimination(PaintSums sums, double smoothness, const std::vector<double>& prior_sigma);

  const SymmetricMatrix& information() const { return s_; }     ///< of the columns
  const std::vector<double>& gradient() const { return g_; }
  double view_sigma() const { return view_sigma_; }             ///< relative

  /// A sample with paint and view taken out of its columns `d`, all in place; what remains of the residual with all that was found.
  double project(const PaintSpline::Basis& b, std::size_t view, double residual, std::vector<double>& d) const;

 private:
  void find_view_sigma(const SymmetricMatrix& views, const Columns& cross, const std::vector<double>& view_gradient, const std::vector<double>& prior_sigma);

  SymmetricMatrix s_;
  std::vector<double> g_;
  double view_sigma_ = 0;
  Columns taken_;                   ///< by column: of the paint's coefficients
  std::vector<double> paint_step_;
  Columns view_taken_;              ///< by column: of the views
  std::vector<double> view_step_, step_;
};

}  // namespace lacquer::calib
