#pragma once

#include <optional>
#include <vector>

#include "libacquire/session.h"
#include "libcalib/calibration.h"

namespace lacquer::calib {

/// The calibration with its geometry moved by one standard error in each of its independent errors: the columns of the Cholesky factor of
/// the covariance of its corrections, whose outer products add up to it. Those that move nothing that samples depend on are left out.
/// nullopt: the geometry was not estimated, or is not the one that its corrections of the rig file's make. What the turntable's angle of each
/// view is off by is not among them: it differs from view to view.
std::optional<std::vector<Calibration>> moved_calibrations(const acquire::Session& session, const Calibration& calibration);

/// Standard errors that all views of a session share, RMS over views and lit pixels.
struct GeometrySigma {
  double half_vector_rad = 0;  ///< half vector against normal
  double distance = 0;         ///< of the light, relative
};
GeometrySigma geometry_sigma(const acquire::Session& session, const Calibration& calibration, const std::vector<Calibration>& moved);

}  // namespace lacquer::calib
