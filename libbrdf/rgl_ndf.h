#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "libbrdf/brdf.h"

namespace lacquer::brdf {

/// Two isotropic distributions of microfacet normals for a tensor file, nodes at theta_m = (j / (n - 1))^2 pi/2, positive, any scale.
struct SamplingNdf {
  std::vector<float> ndf;   ///< D of the file: follows the BRDF, so that the tabulated ratio f_r cos 4 sigma / D is flat
  std::vector<float> warp;  ///< what the file's density of visible normals is made of: wider, so that the flanks of a lobe get nodes too
};

/// Readers use the two independently: the first scales the values, the second places their nodes. Of the analytic model: `ndf` is its
/// lobes in proportion to their reflectance, `warp` equal shares of all lobes at twice their width (half Beckmann, half GGX) and of the
/// diffuse part: of the shapes tried the one with the least error over the eight paints. Of any other BRDF: its values near
/// retro-reflection; their square root with a part that gives the flanks of a peak their nodes.
SamplingNdf sampling_ndf(const Brdf& brdf, std::size_t n);

/// Projected area sigma(theta_i) = integral of <wi, m> D(m) dm, `n` nodes at theta_i = (j / (n - 1))^2 pi/2; linear between the nodes of D.
std::vector<float> projected_area(std::span<const float> ndf, std::size_t n);

}  // namespace lacquer::brdf
