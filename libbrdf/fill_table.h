#pragma once

#include <cstddef>
#include <vector>

#include "libbrdf/brdf.h"
#include "libbrdf/progress.h"
#include "libbrdf/table.h"

namespace lacquer::brdf {

struct FillOptions {
  double min_cosine = 0.03489949670250097;  ///< cos 88 deg: cells whose centre is closer to the horizon are left alone
  double max_sigma = 0.5;         ///< of the logarithm; what cannot be interpolated better is left empty, or taken from `model`
  const Brdf* model = nullptr;    ///< for these and for clipped cells, flagged `modelled`; null: none
  std::size_t n_trials = 6000;    ///< of the cross-validation
  void validate() const;          ///< throws Error{usage} naming the field
};

/// What was done to one channel.
struct FillReport {
  std::size_t n_data = 0;       ///< measured cells that the filling uses
  std::size_t n_symmetric = 0;  ///< taken from the mirror cell
  std::size_t n_filled = 0, n_modelled = 0, n_left = 0;  ///< interpolated; from the model; reachable but still empty
  double length_scale = 0;      ///< chosen by cross-validation, relative to 4 theta_h cells, 8 deg of theta_d
  double trial_mean_abs_log = 0;  ///< error of cells that are known, predicted through the same gaps as the holes
  double trial_sigma_factor = 0;  ///< by which the interpolation's own sigma had to grow for 95 % of these errors to lie within 1.96 sigma; the largest of all classes
};

/// Fills the empty cells of every channel in the logarithm, flagged `filled`, with a variance that grows with the distance from data.
///
/// Each hole is kriged from up to 32 measured cells, the nearest ones along 26 directions: a Gaussian process with a Matern 5/2 covariance in
/// (theta_h cell, theta_d, phi_d sin(theta_h) sin(theta_d)) and linear drifts in theta_h, theta_d and ln(cos(theta_i) cos(theta_o)), after the mean
/// of each theta_h row was taken off, which carries the lobes. So values are positive, reciprocal, mirror symmetric (phi_d and pi - phi_d are
/// one cell for the filling) and smooth away from the peak. Length scale and variance come from cross-validation: the pattern of data around
/// a hole is laid around cells near by that are known. Where data beyond a mirror plane (phi_d = 0 or 90 deg) were used and those on the hole's own side
/// contradict the result, the variance holds their difference. Deterministic.
std::vector<FillReport> fill_holes(HalfAngleTable& table, const FillOptions& options = {}, const Progress& progress = {});

}  // namespace lacquer::brdf
