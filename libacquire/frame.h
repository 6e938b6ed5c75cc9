#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace lacquer::acquire {

/// How colour lies in a frame. The four mosaics are named by their top left 2 x 2 pixels, row by row.
enum class PixelLayout { mono, rgb, bayer_rggb, bayer_grbg, bayer_gbrg, bayer_bggr };

PixelLayout pixel_layout_from_name(const std::string& name);  ///< "mono", "rgb", "rggb", ...; throws Error{input}
std::string name_of(PixelLayout layout);

/// Colour channels a scene has in this layout: 1 (Y) or 3.
int n_channels(PixelLayout layout);
/// Values stored per pixel: 3 for rgb, else 1.
int values_per_pixel(PixelLayout layout);
/// Channel (0 R or Y, 1 G, 2 B) of the value `k` (0 unless rgb) of pixel (x, y).
int channel_of(PixelLayout layout, int x, int y, int k);

/// Rectangle of pixels; (x, y) is its first one.
struct PixelRectangle {
  int x = 0, y = 0, width = 0, height = 0;
};

/// Settings of one exposure, as READ BACK from the device.
struct CaptureSettings {
  double exposure_s = 0;
  double gain_db = 0;
};

/// Raw counts of one exposure: mosaic not interpolated, black not subtracted, right-aligned. Row-major, rgb interleaved R G B.
struct RawFrame {
  int width = 0;
  int height = 0;
  PixelLayout layout = PixelLayout::mono;
  int bits = 16;                    ///< 8..16, values are in [0, 2^bits)
  std::vector<std::uint16_t> data;  ///< width * height * values_per_pixel(layout)
  CaptureSettings actual;
};

/// Reads an 8- or 16-bit PNG, TIFF, PGM/PPM or JPEG. A single-channel file takes `single_channel_layout`, a three-channel file is rgb.
/// Values stay as they are (right-aligned); one that needs more than `bits` bits is an error that names the pixel.
/// Throws Error{file} naming the file: missing, truncated, damaged, alpha, palette, fewer bits stored than expected.
RawFrame read_frame(const std::string& file, int bits, PixelLayout single_channel_layout);
/// The same from the file's content; `name` is used for messages.
RawFrame decode_frame(std::span<const std::byte> bytes, const std::string& name, int bits, PixelLayout single_channel_layout);
/// Uncompressed TIFF, 8 bit if frame.bits == 8, else 16 bit; temporary name, then rename. Returns the checksum of the file.
std::string write_frame(const std::string& file, const RawFrame& frame);

}  // namespace lacquer::acquire
