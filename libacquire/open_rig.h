#pragma once

#include <filesystem>
#include <memory>

#include "libacquire/devices.h"
#include "libacquire/rig_description.h"
#include "libbrdf/brdf.h"

namespace lacquer::acquire {

/// Opens the devices of a rig. `paint`: what the simulated rig photographs; ignored by others.
Rig open_rig(const RigDescription& description, std::shared_ptr<const brdf::Brdf> paint);

/// Simulated devices: photographs of a sphere with any BRDF under a near light of finite size, with perspective, distortion, blur,
/// vignetting, a noisy clipping sensor and the imperfections of description.simulation. Deterministic for a seed and any thread count.
Rig open_simulated_rig(const RigDescription& description, std::shared_ptr<const brdf::Brdf> paint);

/// Real devices through the back ends that the rig's [devices] names. The plan is held against what they can do before anything moves.
/// Nothing lights up or turns. Throws Error {usage, device, timeout}.
Rig open_hardware_rig(const RigDescription& description);

/// Photographs that exist already: the devices return them in the order of the plan.
Rig open_replay_rig(const RigDescription& description);

}  // namespace lacquer::acquire
