#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "libacquire/devices.h"
#include "libacquire/rig_description.h"
#include "libacquire/session.h"
#include "libbrdf/brdf.h"
#include "libbrdf/metrics.h"
#include "libbrdf/progress.h"
#include "libcalib/calibration.h"
#include "libcalib/geometry_session.h"
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
  bool calibrate_geometry = false;  ///< estimate sphere, axis and lights from the merged images before samples are taken
  bool resume = false;  ///< go on with an interrupted capture in the session folder
  std::function<void(acquire::Rig&)> before_frames = {};  ///< as acquire::CaptureOptions
};

struct Measurement {
  acquire::Session session;
  std::size_t n_views = 0;   ///< of all kinds
  std::size_t n_frames = 0;
  calib::Calibration calibration;
  std::optional<calib::SessionGeometry> geometry;  ///< if it was estimated
  calib::Tabulation tabulation;  ///< of the table means, variances and origins; the places of its cells only in the session's table.exr
  fit::FitResult fit;
  std::vector<calib::ViewError> view_errors;           ///< the fit against every merged photograph
  std::vector<std::pair<std::string, double>> seconds; ///< stage, wall time
};

/// Runs the rig's plan into the new folder `session` and writes everything of design.md's session files. Frames are merged as they
/// come where the sensor is known; where it is to be found in them (response = "estimate", dark frames) after all of them are there. The
/// drift of the lights is known at the end only, so samples are taken from the radiance files then.
/// `paint`: what a simulated rig photographs; nothing else of the chain sees it.
Measurement measure(const acquire::RigDescription& rig, std::shared_ptr<const brdf::Brdf> paint, const std::filesystem::path& session,
                    const MeasureOptions& options, const Progress& progress);

}  // namespace lacquer::tools
