#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "libbrdf/brdf.h"

namespace lacquer::brdf {

/// First characters of NVIDIA's measured BSDF files.
inline constexpr char mbsdf_magic[] = "NVIDIA ARC MBSDF V1\n";

struct MbsdfOptions {
  int n_theta = 90;  ///< cells over theta_i and theta_o, [0, pi/2), 2 to 360
  int n_phi = 180;   ///< cells over the azimuth between the directions, [0, pi], 2 to 720
  std::string description = "written by Lacquer";
  void validate() const;  ///< throws Error{usage} naming the field
};

/// NVIDIA .mbsdf (MDL, Iray, Omniverse), RGB reflection, f_r in 1/sr at the centre of each cell of a uniform grid over theta_i, theta_o and
/// the azimuth between them, averaged over both directions and both signs of the azimuth. The grid holds no highlight narrower than a
/// cell: measured paint is best exported as its base, with the clear coat analytic in front. Where the BRDF says nothing the value is
/// that of the nearest azimuth that has one, else 0. Negative values are written as 0.
void write_mbsdf(const std::filesystem::path& file, const Brdf& brdf, const MbsdfOptions& options = {});

/// Reflection part of a .mbsdf file, scalar or RGB; linear between cell centres, constant beyond the outermost, as MDL's renderers look it
/// up. A transmission part is ignored; a file that has no other is an error.
std::unique_ptr<Brdf> read_mbsdf(const std::filesystem::path& file);

}  // namespace lacquer::brdf
