#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "libacquire/devices.h"
#include "libacquire/rig_description.h"
#include "libbrdf/progress.h"

/// Does a rig do what a measurement relies on? Looks at the photographs, not at what the devices say of themselves.
namespace lacquer::acquire {

struct RigCheck {
  enum class Verdict { good, warning, failed } verdict = Verdict::good;
  std::string name;  ///< "camera: linear in exposure"
  std::string text;  ///< what was found, and what to do about it
};

/// quick: one linearity probe with one light, before a capture; about ten frames. full: every light too, and the turntable by 1 degree.
enum class CheckExtent { quick, full };

/// Checks a rig whose devices are open. The turntable goes to an angle of the plan (full: and 1 degree on and back, within its limits);
/// lights are off and the motor is held afterwards, also after an exception. Replay rigs have nothing to check. A device that fails throws
/// its Error; what the frames show comes back.
///
/// The exposures of the frames are never exactly planned ones: a simulated rig counts those.
std::vector<RigCheck> check_rig(Rig& rig, const RigDescription& description, CheckExtent extent, const Progress& progress = {});

/// Enough space for all frames at `folder` (or the nearest folder above that exists)?
RigCheck check_free_space(const RigDescription& description, const std::filesystem::path& folder);

}  // namespace lacquer::acquire
