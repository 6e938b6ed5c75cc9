#pragma once

#include "libacquire/session.h"
#include "libbrdf/progress.h"
#include "libcalib/calibration.h"

namespace lacquer::calib {

/// Estimates the response from the brackets of a few views spread over the session, and the noise where the rig file states none, and
/// puts both into `calibration`. The scale becomes relative unless the response turns out linear: the gauge of an estimated curve is
/// not the sensitivity that the rig file states.
void estimate_session_response(const acquire::Session& session, Calibration& calibration);

/// Frames of every view -> SESSION/radiance/<view>.exr, one view in memory at a time.
void merge_session(const acquire::Session& session, const Calibration& calibration, const Progress& progress);

}  // namespace lacquer::calib
