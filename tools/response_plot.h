#pragma once

#include <filesystem>
#include <string>

#include "libcalib/response.h"

namespace lacquer::tools {

/// Curve of every channel with its 95 % band, and below what is left of it beside the best power law. SVG or PNG, see tools/plot.h.
void plot_response(const calib::Response& response, double black_level_dn, const std::filesystem::path& output);

}  // namespace lacquer::tools
