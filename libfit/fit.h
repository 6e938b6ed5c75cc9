#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "libbrdf/cook_torrance.h"
#include "libbrdf/metrics.h"
#include "libbrdf/progress.h"
#include "libbrdf/table.h"

namespace lacquer::fit {

struct FitOptions {
  std::optional<int> n_lobes = std::nullopt;  ///< 0..5, all coloured, over a diffuse part; none: the structure is chosen, 0 to 3 lobes
  int n_starts = 6;            ///< starts refined on a subset for each number of lobes
  /// Cells used: all, or a stratified choice over theta_h, theta_d, phi_d when the table has more.
  std::size_t max_cells = brdf::TableGrid::n_cells;
  double model_sigma =
      0.01;  ///< relative error of the model and of the cell average, added to the table's variance; > 0
  double min_cosine = 0.08715574274765817;  ///< cos 85 deg: cells closer to grazing are left out
  double min_m = 0.001;                     ///< lower bound of m, in (0, 1)
  double robust_scale =
      3.0;  ///< Huber threshold in sigmas (towards the paper's absolute log ratio for outliers)
  double energy_weight =
      10.0;  ///< 10 % more reflected than received costs this / 10 sigma on every cell; 0: no energy penalty
  /// Where the model does not fit the paint, cells of one (theta_h, theta_d) count together (FitResult::shared_error); else each for itself.
  bool limit_groups = true;
  /// Where the structure is chosen, GGX and the exact Fresnel term of a dielectric are tried lobe by lobe beside the paper's forms.
  bool other_forms = true;
  /// Profile intervals of all parameters, see profile.h; minutes on a full table. Without it: of those whose error reaches a bound or their
  /// own size, where at most 100 000 cells are used.
  bool profile = false;
  double half_vector_sigma = 0;  ///< radians, of half vectors against normals, as the geometry is known: blurs lobes, in the error of m
  bool ceres = false;    ///< Ceres' solver instead of our own, to check one by the other; slower
  int max_iterations = 200;
  unsigned threads = 0;   ///< 0: all; the result does not depend on it
  void validate() const;  ///< throws Error{usage} naming the field
};

/// What the profile of the objective says of a parameter, see profile.h.
struct ProfileInterval {
  double low68 = 0, high68 = 0, low95 = 0, high95 = 0;
};

/// A fitted parameter with its standard error; `determined` false: the data says nothing about it (e.g. m of
/// a lobe with ks = 0).
struct Parameter {
  std::string name;  ///< "kd.r", "ks1.g", "m2", "r3"; lobes count from 1 in the model's order; "kd.y" in a
                     ///< one-channel table
  double value = 0;
  double sigma = 0;  ///< from the covariance, 0 where not determined and for ks of a lobe that is off
  bool at_bound = false;  ///< or nearer to it than a tenth of sigma
  bool determined = true;
  double calibration_sigma = 0;  ///< contained in sigma: of the geometry's errors, where they are known; not that of the scale
  double inflation = 1;  ///< contained in sigma: factor on what the curvature alone says
  std::optional<ProfileInterval> profile = std::nullopt;  ///< without the error of the table's scale
};

/// A minimum that starts led to.
struct Minimum {
  brdf::CookTorrance model;
  double cost = 0;  ///< robust objective per residual, on the subset
};

/// A structure that was tried. The one of the smallest criterion wins: cost / c + p ln(n / c) with p parameters, n residuals and c the
/// factor by which residuals that agree within a row or a column of the table inflate the objective (Schwarz 1978 with the effective
/// number of independent values).
struct Candidate {
  brdf::CookTorrance model;
  std::string structure;     ///< for people, e.g. "2 lobes, lobe 2 grey"
  int n_parameters = 0;
  double cost = 0;           ///< robust objective per residual, all cells
  double mean_abs_log = 0;   ///< as FitResult::mean_abs_log
  double criterion = 0;      ///< above that of the winner; below it where a lobe of the candidate does not stand out from its errors
  double evaluation_ns = 0;  ///< of one RGB value in an array, see add_evaluation_costs; 0: not measured
  bool pareto = false;       ///< none that was tried evaluates faster and is as near (mean_abs_log); set with evaluation_ns
};

/// How far the model is from what it was fitted to, by several measures, and how far its errors let it be.
struct FitMetrics {
  brdf::BrdfDifference difference;  ///< of the model from the table, directions within 80 deg
  std::size_t probe_pixels = 0;     ///< of a sphere under a light probe; 0: none was rendered
  double probe_delta_e_mean = 0, probe_delta_e_p95 = 0;  ///< CIEDE2000 there
  double delta_e_of_errors = 0;     ///< CIEDE2000 of lit spheres, mean, between the model and models drawn from its covariance
};

/// Why cells of a table did not enter the fit; one count per cell and channel.
struct LeftOut {
  std::size_t grazing = 0;  ///< a cosine <= FitOptions::min_cosine
  std::size_t not_positive =
      0;  ///< mean <= 0 in a cell without a variance: its logarithm does not exist and its error is not known
  std::size_t not_finite =
      0;  ///< NaN, infinite, a negative variance or footprint, or coordinates outside the hemisphere
  std::size_t not_measured = 0;  ///< mirrored, filled or modelled cells: no information of their own
};

struct FitResult {
  brdf::CookTorrance model;  ///< lobes ordered by falling m; one-channel tables: three equal channels
  std::vector<Parameter> parameters;  ///< kd.r kd.g kd.b ks1.r ... m1 r1 ...; those of the structure alone
  std::vector<double>
      covariance;  ///< row-major n x n in the order of `parameters`; 0 in rows without a sigma
  std::vector<Minimum> minima;        ///< distinct minima with the chosen number of lobes, best first
  std::vector<Candidate> candidates;  ///< structures that were tried, the chosen one first, then by rising criterion
  double overdispersion = 1;          ///< c of Candidate
  double parameter_price = 0;         ///< ln(n / c) of Candidate; 0: nothing was chosen
  /// Relative error that cells of one (theta_h, theta_d) were found to share because the model does not fit the paint: limits what they
  /// count together. 0 where it fits.
  double shared_error = 0;
  std::size_t n_cells = 0;            ///< used
  std::size_t n_cells_available = 0;  ///< usable cells of the table
  std::size_t n_residuals = 0;        ///< used cells times their channels, without bounds
  std::size_t n_bounds = 0;           ///< clipped cells times their channels: the model is to be at least that
  LeftOut left_out;
  double scale_sigma = 0;  ///< relative standard error of the table's scale; contained in the errors of kd and ks
  double mean_abs_log = 0;  ///< mean |ln(model / mean)| over used cells with positive mean
  double rms_log = 0;
  double reduced_chi2 =
      0;              ///< robust objective per degree of freedom; about 1 if model and variances are right
  double energy = 0;  ///< estimate of the largest normal-incidence albedo of the channels; > 1 is implausible
  bool converged = false;  ///< a status, not an error
  std::string message;     ///< of the solver
  FitOptions options;      ///< as used
  std::optional<FitMetrics> metrics = std::nullopt;  ///< by whoever can render; not by the fit
  double seconds = 0;
};

/// Fits kd, ks, m, r of a multi-lobe Cook-Torrance model to the measured cells of a table (Günther et al.
/// 2005, 4.2).
///
/// Residual of a cell: ln(model / mean) / sigma where the signal stands well above its noise, (model - mean)
/// / sigma where it does not (logarithms of noisy dark values are biased); sigma from the table's variance
/// and FitOptions::model_sigma; Huber loss. The result depends neither on a seed nor on the number of
/// threads. Throws Error{input} when the table has too few usable cells.
FitResult fit_table(const brdf::HalfAngleTable& table, const FitOptions& options = {},
                    const Progress& progress = {});

/// The same in less memory: coordinates, footprints and counts of `table`, four fifths of it, are freed as soon as they have been seen.
/// Means, variances and origins stay, so that the table can still be asked for values.
FitResult fit_and_free_places(brdf::HalfAngleTable& table, const FitOptions& options = {}, const Progress& progress = {});

/// Measures how long the candidates take to evaluate in an array on this machine (milliseconds of work).
void add_evaluation_costs(FitResult& fit);

/// Text of fit.json; the paint entry ("kd", "lobes") is at top level as in papers/table1.json. The same
/// result gives the same bytes: times and threads are not in it.
std::string fit_to_json(const FitResult& fit, bool absolute_scale, const std::string& provenance_json);
void write_fit(const std::filesystem::path& file, const FitResult& fit, bool absolute_scale,
               const std::string& provenance_json);

}  // namespace lacquer::fit
