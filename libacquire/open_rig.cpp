#include "libacquire/open_rig.h"

#include "libbrdf/error.h"

namespace lacquer::acquire {

Rig open_rig(const RigDescription& description, std::shared_ptr<const brdf::Brdf> paint) {
  switch (description.kind) {
    case RigDescription::Kind::simulated: return open_simulated_rig(description, std::move(paint));
    case RigDescription::Kind::replay: return open_replay_rig(description);
    case RigDescription::Kind::hardware: return open_hardware_rig(description);
  }
  throw Error(ErrorCode::usage, description.file.string() + ": rig.kind: no devices for this kind of rig");
}

}  // namespace lacquer::acquire
