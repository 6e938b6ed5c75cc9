#pragma once

#include <nlohmann/json_fwd.hpp>

#include "libacquire/session.h"
#include "libcalib/geometry_session.h"

namespace lacquer::tools {

/// Table of an estimated geometry on stdout; of a simulated rig also its errors against the truth.
void print_geometry(const calib::SessionGeometry& geometry, const acquire::Session& session);
/// The same as JSON.
nlohmann::ordered_json geometry_json(const calib::SessionGeometry& geometry, const acquire::Session& session);

}  // namespace lacquer::tools
