#pragma once

#include <string>

#include "libbrdf/cook_torrance.h"

namespace lacquer::brdf {

/// Text of a .brdf file for Disney's BRDF Explorer: the model as GLSL with its parameters as sliders (kd, and ks, m, r of each lobe). The same
/// function as CookTorrance::value in single precision; no loss but the display's. `comment`: printable text for the head.
std::string brdf_explorer_text(const CookTorrance& model, const std::string& comment);

/// The parameters of a text that brdf_explorer_text wrote. Throws Error{file} naming the line.
CookTorrance brdf_explorer_model(const std::string& text, const std::string& name_for_errors);

}  // namespace lacquer::brdf
