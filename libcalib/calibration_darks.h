#pragma once

#include "libacquire/session.h"
#include "libbrdf/progress.h"
#include "libcalib/calibration.h"

namespace lacquer::calib {

/// What the dark views of a session say about its sensor takes the place of what `calibration` assumed, where it differs by more than
/// four standard errors: black level, dark current and read noise. Hot and erratic values become bad ones. Maps of the black level and of
/// the dark current are used where they are better than none (photon_transfer.h); a flat field, bad values and, where the darks are too
/// few for their own, maps of the rig file are kept. Maps are written to SESSION/maps.exr. dark_source says in words what was done.
/// Dark frames that cannot be used (light in them) change nothing, and dark_source says why. Without dark views nothing happens.
void apply_dark_views(const acquire::Session& session, Calibration& calibration, const Progress& progress);

}  // namespace lacquer::calib
