#pragma once

#include <glm/vec3.hpp>

namespace lacquer::brdf {

/// CIE 1931 XYZ of linear sRGB (IEC 61966-2-1: Rec. 709 primaries, D65 white x = 0.3127, y = 0.3290), Y = 1
/// for (1, 1, 1).
glm::dvec3 xyz_from_linear_srgb(const glm::dvec3& rgb);

/// CIE L*a*b* (D65) of linear sRGB / Rec. 709 primaries, 1 = diffuse white. Negative input is taken as it is
/// (no clamp).
glm::dvec3 lab_from_linear_srgb(const glm::dvec3& rgb);

/// CIEDE2000 colour difference (Sharma, Wu, Dalal 2005), kL = kC = kH = 1. Symmetric; exactly 0 for equal
/// colours.
double delta_e_2000(const glm::dvec3& lab_a, const glm::dvec3& lab_b);

}  // namespace lacquer::brdf
