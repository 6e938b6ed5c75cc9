#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "libbrdf/brdf.h"

namespace lacquer::brdf {

/// Size of a tensor file against its error, see docs/formats.md.
struct RglOptions {
  int n_theta_i = 32;    ///< incident angles, 2 to 256
  int resolution = 64;   ///< nodes of each side of the square of values per incident angle, 8 to 512
  int ndf_theta = 256;   ///< nodes of the microfacet distribution and of the density of visible normals over theta_m, 16 to 2048
  int ndf_phi = 64;      ///< the same over phi_m, 8 to 512
  bool spectral = false; ///< `spectra` at 16 wavelengths instead of `rgb`, for renderers that work in spectra (pbrt-v4)
  std::string description = "written by Lacquer";
  void validate() const;  ///< throws Error{usage} naming the field
};

/// Writes an isotropic tensor file .bsdf (Dupuy and Jakob 2018) that every reader of the RGL database understands. The microfacet
/// distributions decide where the nodes lie, not what the values are, see rgl_ndf.h. Where a direction lies below the horizon or the BRDF says
/// nothing, values are continued from their neighbours and the field `valid` (packed bits, as numpy.packbits) has 0.
/// Spectra: smooth, non-negative curves whose linear sRGB under equal energy is the RGB value, see rgl_spectrum.h. Negative values
/// are written as 0: readers clamp them.
/// Throws Error{input} if the BRDF says nothing anywhere.
void write_rgl(const std::filesystem::path& file, const Brdf& brdf, const RglOptions& options = {});

}  // namespace lacquer::brdf
