#include "libbrdf/rgl_spectrum.h"

#include <cmath>
#include <glm/mat3x3.hpp>
#include <glm/matrix.hpp>

#include "libbrdf/rgl_warp.h"

namespace lacquer::brdf {

namespace {

/// Gaussian with one width on each side of its peak.
double lobe(double x, double peak, double sigma_below, double sigma_above) {
  const double t = (x - peak) / (x < peak ? sigma_below : sigma_above);
  return std::exp(-0.5 * t * t);
}

glm::dmat3 from_rows(const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c) { return glm::transpose(glm::dmat3(a, b, c)); }

/// XYZ -> linear sRGB, IEC 61966-2-1.
glm::dmat3 srgb_from_xyz() {
  return from_rows({3.2406, -1.5372, -0.4986}, {-0.9689, 1.8758, 0.0415}, {0.0557, -0.2040, 1.0570});
}

/// Cone responses of the Bradford transform (Lam 1985), in which whites are adapted by scaling.
glm::dmat3 bradford() { return from_rows({0.8951, 0.2664, -0.1614}, {-0.7502, 1.7135, 0.0367}, {0.0389, -0.0685, 1.0296}); }

/// Linear sRGB of XYZ seen under `white`; white itself becomes (1, 1, 1).
glm::dmat3 adapted_srgb_from_xyz(const glm::dvec3& white) {
  const glm::dvec3 d65 = glm::inverse(srgb_from_xyz()) * glm::dvec3(1.0);
  const glm::dvec3 gain = (bradford() * d65) / (bradford() * white);
  const glm::dmat3 scale(gain.x, 0, 0, 0, gain.y, 0, 0, 0, gain.z);
  return srgb_from_xyz() * glm::inverse(bradford()) * scale * bradford();
}

}  // namespace

glm::dvec3 cie_1931_matching_functions(double nm) {
  return {1.056 * lobe(nm, 599.8, 37.9, 31.0) + 0.362 * lobe(nm, 442.0, 16.0, 26.7) - 0.065 * lobe(nm, 501.1, 20.4, 26.2),
          0.821 * lobe(nm, 568.8, 46.9, 40.5) + 0.286 * lobe(nm, 530.9, 16.3, 31.1),
          1.217 * lobe(nm, 437.0, 11.8, 36.0) + 0.681 * lobe(nm, 459.0, 26.0, 13.8)};
}

std::vector<float> upsampling_wavelengths() {
  std::vector<float> nm;
  for (int i = 0; i < 16; ++i) nm.push_back(static_cast<float>(400 + 20 * i));
  return nm;
}

std::vector<glm::dvec3> upsampling_spectra() {
  // Printed by tests/libbrdf/rgl_upsampling.py.
  return {{0.106545223, 0.000000000, 0.893454777}, {0.058987402, 0.000000000, 0.941012598}, {0.013355223, 0.000000000, 0.986644777},
          {0.009780461, 0.005932701, 0.984286838}, {0.000000000, 0.291015371, 0.708984629}, {0.000000000, 0.703895023, 0.296104977},
          {0.000000000, 0.981594633, 0.018405367}, {0.000000000, 1.000000000, 0.000000000}, {0.000000000, 1.000000000, 0.000000000},
          {0.130125489, 0.810998656, 0.058875856}, {0.656537091, 0.328651914, 0.014810994}, {1.000000000, 0.000000000, 0.000000000},
          {1.000000000, 0.000000000, 0.000000000}, {1.000000000, 0.000000000, 0.000000000}, {1.000000000, 0.000000000, 0.000000000},
          {0.999476695, 0.000347490, 0.000175816}};
}

std::vector<glm::dvec3> linear_srgb_weights(std::span<const float> wavelengths_nm) {
  std::vector<glm::dvec3> weights(wavelengths_nm.size(), glm::dvec3(0.0));
  glm::dvec3 white(0.0);
  for (int nm = 360; nm <= 830; ++nm) {  // 1 nm steps, as the CIE tabulates; the functions vanish at both ends
    const glm::dvec3 xyz = cie_1931_matching_functions(nm);
    const Blend at = blend_between(wavelengths_nm, nm);
    weights[at.first] += (1 - at.weight) * xyz;
    weights[at.second] += at.weight * xyz;
    white += xyz;
  }
  const glm::dmat3 to_rgb = adapted_srgb_from_xyz(white);
  for (auto& w : weights) w = to_rgb * w;
  return weights;
}

}  // namespace lacquer::brdf
