#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "libbrdf/cook_torrance.h"
#include "libbrdf/progress.h"
#include "libbrdf/table.h"

namespace lacquer::fit {

struct FitOptions {
  int n_lobes = 3;                   ///< 0..5
  int n_starts = 6;                  ///< distinct starts refined on a subset before the best is refined on all cells
  std::size_t max_cells = 100000;    ///< cells used, a stratified choice over theta_h and theta_d when the table has more
  double model_sigma = 0.01;         ///< relative error of the model and of the cell average, added to the table's variance
  double min_cosine = 0.08715574274765817;  ///< cos 85 deg: cells closer to grazing are left out
  double robust_scale = 3.0;         ///< Huber threshold in sigmas (towards the paper's absolute log ratio for outliers)
  int max_iterations = 200;
  unsigned threads = 0;              ///< 0: all; the result does not depend on it
  void validate() const;             ///< throws Error{usage} naming the field
};

/// A fitted parameter with its standard error; `determined` false: the data says nothing about it (e.g. m of a lobe with ks = 0).
struct Parameter {
  std::string name;    ///< "kd.r", "ks1.g", "m2", "r3"
  double value = 0;
  double sigma = 0;    ///< from the covariance, 0 where not determined
  bool at_bound = false;
  bool determined = true;
};

struct Candidate {
  brdf::CookTorrance model;
  double cost = 0;       ///< robust objective per residual, on the subset
};

struct FitResult {
  brdf::CookTorrance model;              ///< lobes ordered by falling m
  std::vector<Parameter> parameters;     ///< kd.r kd.g kd.b ks1.r ... m1 r1 ...
  std::vector<double> covariance;        ///< row-major n x n in the order of `parameters`
  std::vector<Candidate> candidates;     ///< distinct minima of the starts, best first
  std::size_t n_cells = 0;               ///< used
  std::size_t n_cells_available = 0;
  double mean_abs_log = 0;               ///< over used cells with positive mean
  double rms_log = 0;
  double reduced_chi2 = 0;
  bool converged = false;                ///< a status, not an error
  std::string message;                   ///< of the solver
  double seconds = 0;
};

/// Fits kd, ks, m, r of a multi-lobe Cook-Torrance model to the measured cells of a table in log space (Günther et al. 2005, 4.2).
/// Throws Error{input} when the table has too few usable cells.
FitResult fit_table(const brdf::HalfAngleTable& table, const FitOptions& options = {}, const Progress& progress = {});

/// fit.json; the paint entry ("kd", "lobes") is at top level as in papers/table1.json.
void write_fit(const std::filesystem::path& file, const FitResult& fit, bool absolute_scale, const std::string& provenance_json);

}  // namespace lacquer::fit
