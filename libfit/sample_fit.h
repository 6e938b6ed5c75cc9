#pragma once

#include <cstddef>
#include <functional>
#include <span>
#include <vector>

#include "libbrdf/directions.h"
#include "libbrdf/progress.h"
#include "libfit/fit.h"

namespace lacquer::fit {

/// One measurement of f_r.
struct SampleValue {
  brdf::HalfDiff coordinates;
  brdf::Footprint<double> footprint;
  double value = 0;      ///< 1/sr; `clipped`: a lower bound
  double variance = 0;   ///< of value
  int channel = 0;
  bool clipped = false;
};

/// The samples of a session, which need not fit into memory together.
struct SampleSource {
  int n_channels = 3;  ///< 1 or 3
  std::size_t n_views = 0;
  using Sink = std::function<void(std::span<const SampleValue>)>;
  /// Delivers the samples of a view piece by piece, the same ones at every call. Called from several threads, each for its own view.
  std::function<void(std::size_t view, const Sink& sink)> view;
};

/// Fits the structure of `table_fit`, the fit to a table of the same samples, to the samples themselves: each at its own place and with its
/// own footprint, so that nothing is averaged over a cell. Starts there and weighs by its model, so a few passes over the samples are all;
/// only normal equations are kept. Errors as of a table, and clustered by view too; options are table_fit's, `n_cells` counts samples.
/// `perturbed`: the same samples as seen with the calibration moved by one standard error in one of its independent directions each; the
/// steps that the parameters would take are added to their covariance. The same bytes for any number of threads. Throws Error{input} when
/// there are too few samples.
FitResult fit_samples(const SampleSource& source, const FitResult& table_fit, bool absolute_scale,
                      const std::vector<SampleSource>& perturbed = {}, const Progress& progress = {});

}  // namespace lacquer::fit
