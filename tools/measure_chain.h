#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "libacquire/rig_description.h"
#include "libbrdf/brdf.h"
#include "libbrdf/metrics.h"
#include "libbrdf/progress.h"
#include "libcalib/calibration.h"
#include "libcalib/rerender.h"
#include "libcalib/samples.h"
#include "libfit/fit.h"

/// The whole chain frames -> radiance -> samples -> table -> parameters behind `lacquer measure`.
namespace lacquer::tools {

struct MeasureOptions {
  calib::SampleOptions samples;
  fit::FitOptions fit;
  std::string command_line;
  std::string provenance_json;
};

struct Measurement {
  std::size_t n_views = 0;
  std::size_t n_frames = 0;
  calib::Calibration calibration;
  calib::Tabulation tabulation;
  fit::FitResult fit;
  std::vector<calib::ViewError> view_errors;           ///< the fit against every merged photograph
  std::vector<std::pair<std::string, double>> seconds; ///< stage, wall time
};

/// Runs the rig's plan into the new folder `session` and writes everything of design.md's session files. A view is merged and
/// sampled while its frames are in memory when the response is known; with response = "estimate" after all frames are there.
/// `paint`: what a simulated rig photographs; nothing else of the chain sees it.
Measurement measure(const acquire::RigDescription& rig, std::shared_ptr<const brdf::Brdf> paint, const std::filesystem::path& session,
                    const MeasureOptions& options, const Progress& progress);

}  // namespace lacquer::tools
