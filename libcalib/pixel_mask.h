#pragma once

#include <cstdint>
#include <vector>

#include "libacquire/rig_description.h"
#include "libcalib/radiance_image.h"

namespace lacquer::calib {

/// What of the sphere is paint, by the rig file's [mask]; row-major, width * height of the geometry's camera, 0: it is not. Pixels beside
/// the sphere are what the mask's file says, or paint. Throws Error{file}: the file cannot be read, or does not have the camera's size.
std::vector<std::uint8_t> paint_mask(const acquire::MaskDescription& mask, const acquire::RigGeometry& geometry);

/// Marks as invalid what is not paint.
void apply_mask(const std::vector<std::uint8_t>& mask, RadianceImage& image);

}  // namespace lacquer::calib
