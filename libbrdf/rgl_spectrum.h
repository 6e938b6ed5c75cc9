#pragma once

#include <glm/vec3.hpp>
#include <span>
#include <vector>

namespace lacquer::brdf {

/// Colour matching functions x, y, z of the CIE 1931 standard observer (2 degrees) at a wavelength in nm, peak of y near 1: the
/// multi-lobe fit of Wyman, Sloan, Shirley, "Simple Analytic Approximations to the CIE XYZ Color Matching Functions", JCGT 2013.
glm::dvec3 cie_1931_matching_functions(double wavelength_nm);

/// Weights w with linear sRGB = sum_l w[l] * spectrum[l]. The spectrum is linear between its wavelengths (nm, ascending) and constant
/// beyond them; it is lit by equal energy and integrated from 360 to 830 nm. White is adapted from equal energy to D65
/// (Bradford), so that the constant spectrum 1 becomes RGB (1, 1, 1). Out-of-gamut colours have negative components.
std::vector<glm::dvec3> linear_srgb_weights(std::span<const float> wavelengths_nm);

/// Upsampling of linear sRGB to smooth spectra: sum_c rgb[c] * spectra[l][c] at the wavelengths below. Non-negative for non-negative RGB,
/// constant for grey, and linear_srgb_weights() of these wavelengths gives the RGB back.
std::vector<float> upsampling_wavelengths();  ///< nm, ascending
std::vector<glm::dvec3> upsampling_spectra();

}  // namespace lacquer::brdf
