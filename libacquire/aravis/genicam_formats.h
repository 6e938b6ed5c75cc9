#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "libacquire/frame.h"
#include "libacquire/pixel_packing.h"

namespace lacquer::acquire {

/// A raw pixel format of GenICam (PFNC) that this program takes: counts as the converter gave them, mosaic not interpolated.
struct GenicamFormat {
  std::string_view name;  ///< as in the camera's PixelFormat feature, "BayerRG12Packed"
  std::uint32_t code;     ///< as in the image's leader
  PixelLayout layout;
  int bits;
  Packing packing;
};

/// nullptr: not a raw format, or not known.
const GenicamFormat* genicam_format(std::string_view name);

/// Formats with this layout and depth, the best first: unpacked before packed (the same counts, no unpacking).
std::vector<const GenicamFormat*> genicam_formats(PixelLayout layout, int bits);

}  // namespace lacquer::acquire
