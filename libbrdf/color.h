#pragma once

#include <glm/vec3.hpp>

namespace lacquer::brdf {

/// CIE L*a*b* (D65) of linear sRGB / Rec. 709 primaries, 1 = diffuse white. Negative input is taken as it is (no clamp).
glm::dvec3 lab_from_linear_srgb(const glm::dvec3& rgb);

/// CIEDE2000 colour difference (Sharma, Wu, Dalal 2005), kL = kC = kH = 1.
double delta_e_2000(const glm::dvec3& lab_a, const glm::dvec3& lab_b);

}  // namespace lacquer::brdf
