#pragma once

#include <filesystem>
#include <string>

#include "libacquire/rig_description.h"
#include "libcalib/coverage.h"
#include "tools/command.h"

/// What a capture will be, from its rig file alone.
namespace lacquer::tools {

struct DryRunOptions {
  std::filesystem::path session;  ///< where it would be written; empty: not known yet
  std::filesystem::path map;      ///< SVG or PNG of the coverage; empty: as text
  calib::SampleOptions samples;
};

/// Prints plan, duration, disk space against what is free, and the predicted coverage of the table. Opens no device, writes nothing but
/// options.map.
void print_dry_run(const acquire::RigDescription& rig, const DryRunOptions& options, const Context& context);

/// "12.3 s", "4 min 05 s", "2 h 03 min".
std::string duration_text(double seconds);

/// Covered share of the reachable cells over phi_d as text: theta_h down, theta_d right, a digit for tenths (0: below 5 %), '#' for all,
/// '.' for none, blank where no direction is above the horizon.
std::string coverage_map_text(const calib::CoverageMap& map);

}  // namespace lacquer::tools
