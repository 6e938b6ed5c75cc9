#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "libacquire/rig_description.h"
#include "libbrdf/metrics.h"
#include "libcalib/geometry_difference.h"
#include "libfit/fit.h"
#include "rigs.h"

/// A paint measured end to end on a rig whose builder had a ruler, with calibrated and with true geometry.
namespace lacquer::bench {

/// A lobe that contributes: somewhere in the hemisphere at least 5 % of f_r, in some channel.
struct LobeError {
  std::size_t lobe = 0;     ///< of the truth, from 1
  double true_m = 0;
  double m = 0;             ///< of the fitted lobe nearest in ln m; 0: there is none
};

/// One fit against the truth.
struct PaintFit {
  brdf::BrdfDifference difference;
  std::vector<LobeError> lobes;
  double reduced_chi2 = 0;
};

struct PaintResult {
  std::string paint;
  PaintFit known, calibrated;
  calib::GeometryDifference geometry;  ///< of the calibrated one
  double simulation_s = 0, geometry_s = 0, fits_s = 0;
};

/// Radiance images go to `folder`, which is removed afterwards. Raw frames are merged as they are exposed and never written.
PaintResult measure_paint(const acquire::RigDescription& nominal, const BuilderErrors& errors, const std::filesystem::path& paint,
                          const std::filesystem::path& folder);

std::string paint_table(const std::vector<PaintResult>& results);

}  // namespace lacquer::bench
