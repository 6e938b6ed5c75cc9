#pragma once

#include <string>

#include "libcalib/geometry_moves.h"

namespace lacquer::tools {

/// Provenance of a table with what its geometry is known to, under "geometry_sigma"; unchanged where that is not known.
std::string with_geometry_sigma(const std::string& provenance_json, const calib::GeometrySigma& sigma);

/// Radians, of half vectors, from a table's provenance; 0: it says nothing of it.
double half_vector_sigma_of(const std::string& provenance_json);

/// For people, of a fit to a table: which errors of its geometry the standard errors contain and what has all of them; empty: the geometry was not
/// estimated. `session`: its folder.
std::string table_geometry_note(double half_vector_sigma, const std::string& session);

}  // namespace lacquer::tools
