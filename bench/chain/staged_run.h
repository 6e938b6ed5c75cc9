#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <string>

#include "libacquire/rig_description.h"
#include "libbrdf/brdf.h"
#include "libbrdf/table.h"
#include "libfit/fit.h"

namespace lacquer::bench {

struct StagedRun {
  brdf::HalfAngleTable table;
  brdf::CookTorrance model;
  std::map<std::string, double> seconds;  ///< merge, tabulate, write table, fit: wall time, nothing else running meanwhile
};

/// Simulates the session of `rig` in the new folder, which is not timed, then runs stage after stage from its frames on disk.
StagedRun run_stages(const acquire::RigDescription& rig, std::shared_ptr<const brdf::Brdf> paint, const std::filesystem::path& session, const fit::FitOptions& options);

}  // namespace lacquer::bench
