#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "libacquire/session.h"
#include "libbrdf/brdf.h"
#include "libcalib/samples.h"

namespace lacquer::calib {

/// How well a paint explains one photograph, over its usable, unclipped values.
struct ViewError {
  std::string view;
  std::size_t n_values = 0;
  double relative_rms = 0;   ///< sqrt(sum (predicted - measured)^2 / sum measured^2)
  double mean_abs_log = 0;   ///< mean |ln(predicted / measured)| over values brighter than 5 sigma
  double bias_log = 0;       ///< mean ln(predicted / measured) over the same
};

struct RerenderOptions {
  SampleOptions samples;
  int n_pictured = 4;  ///< views in the picture, spread evenly over the session
};

/// Renders every measurement view of a session with `paint` and the session's calibration and compares it with the merged photograph.
/// `picture` (unless empty): PNG, a row per pictured view: photograph, re-rendering, difference (grey: none, red: rendering too
/// bright, blue: too dark, full colour at +-25 % of the photograph's white). Both images of a row share one exposure, sRGB-coded.
std::vector<ViewError> rerender_session(const acquire::Session& session, const Calibration& calibration, const brdf::Brdf& paint,
                                        const RerenderOptions& options, const std::filesystem::path& picture, const Progress& progress);

}  // namespace lacquer::calib
