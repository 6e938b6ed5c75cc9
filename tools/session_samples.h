#pragma once

#include <filesystem>
#include <memory>

#include "libacquire/session.h"
#include "libcalib/calibration.h"
#include "libcalib/samples.h"
#include "libfit/sample_fit.h"

namespace lacquer::tools {

/// The samples of a session's measurement views for fit::fit_samples: read from the radiance images again at every pass, so that only one
/// image per thread is in memory. Throws Error{file} naming an image that is missing.
fit::SampleSource session_samples(std::shared_ptr<const acquire::Session> session, const calib::Calibration& calibration,
                                  const calib::SampleOptions& options);

}  // namespace lacquer::tools
