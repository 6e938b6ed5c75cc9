#pragma once

#include <cstddef>
#include <span>
#include <string>

namespace lacquer::acquire {

/// What an image file says about itself, found without decoding it.
struct ImageHeader {
  int width = 0;
  int height = 0;
  int bits = 0;      ///< per value, 8 or 16
  int channels = 0;  ///< 1 or 3
};

/// Header of a PNG, TIFF, binary PGM/PPM or JPEG. Decoders are lenient: they return half an image, or fill in grey, where a file ends
/// too early. So this checks first that all of the image is there (chunks and their CRC, strips, pixel bytes, end marker) and that it
/// is of a kind that holds raw counts: 8 or 16 bit integers, grey or RGB, no palette, no alpha.
/// Throws Error{file}, one line, beginning with `name`.
ImageHeader read_image_header(std::span<const std::byte> bytes, const std::string& name);

}  // namespace lacquer::acquire
