#pragma once

#include <filesystem>
#include <optional>

#include "libacquire/rig_description.h"
#include "libbrdf/cook_torrance.h"
#include "libbrdf/metrics.h"
#include "tools/measure_chain.h"

namespace lacquer::tools {

/// Writes SESSION/report.html: one self-contained page (pictures embedded, no scripts, no network) with warnings first, parameters
/// beside the truth, errors, re-rendered photographs, theta_h x theta_d slices of table and fit, lit spheres, times, provenance.
void write_report(const std::filesystem::path& session, const acquire::RigDescription& rig, const Measurement& measurement,
                  const brdf::CookTorrance* truth, const std::optional<brdf::BrdfDifference>& against_truth);

}  // namespace lacquer::tools
