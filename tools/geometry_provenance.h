#pragma once

#include <string>

#include "libcalib/geometry_moves.h"

namespace lacquer::tools {

/// Provenance of a table with what its geometry is known to, under "geometry_sigma"; unchanged where that is not known.
std::string with_geometry_sigma(const std::string& provenance_json, const calib::GeometrySigma& sigma);

/// Radians, of half vectors, from a table's provenance; 0: it says nothing of it.
double half_vector_sigma_of(const std::string& provenance_json);

}  // namespace lacquer::tools
