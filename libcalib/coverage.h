#pragma once

#include <vector>

#include "libacquire/rig_description.h"
#include "libbrdf/progress.h"
#include "libbrdf/table.h"
#include "libcalib/samples.h"

namespace lacquer::calib {

/// Cells that a plan will measure: every view of it goes through the sampler with the rig file's geometry, as if each value of each frame
/// were usable. Means are 0; counts, coordinates and origins are those of a measurement that clips nothing and reads the planned
/// angles back. Clipped values and noise of the angles are all that a real run can differ by.
Tabulation predict_coverage(const acquire::RigDescription& rig, const SampleOptions& options, const Progress& progress);

/// Of one channel, over phi_d, for cells (theta_h, theta_d): reachable cells, and those measured or known by mirror symmetry.
struct CoverageMap {
  struct Entry {
    int reachable = 0, covered = 0;
  };
  std::vector<Entry> entries;  ///< n_theta_h * n_theta_d, theta_d fastest
  const Entry& at(int theta_h, int theta_d) const { return entries[static_cast<std::size_t>(theta_h * brdf::TableGrid::n_theta_d + theta_d)]; }
};
CoverageMap coverage_map(const brdf::TableChannel& channel);

}  // namespace lacquer::calib
