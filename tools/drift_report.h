#pragma once

#include <filesystem>
#include <string>

#include "libcalib/calibration.h"

/// What lights and darkness did during a session, for `lacquer measure` and `lacquer merge`.
namespace lacquer::tools {

/// A line on the dark frames (if any were taken) and one or more on the lights.
std::string light_and_dark_text(const calib::Calibration& calibration);

/// Draws the intensity of each light over time, points with their standard errors (flicker included) and the model with its band of two
/// standard errors, to `output` (SVG or PNG); the first eight lights. Nothing is written, and false returned, where no light was followed.
bool plot_drift(const calib::Calibration& calibration, const std::filesystem::path& output);

}  // namespace lacquer::tools
