#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "libacquire/frame.h"
#include "libacquire/pixel_packing.h"

namespace lacquer::acquire {

/// A V4L2 pixel format that this program takes. `processed`: the camera has made a picture of the counts (YUYV: chroma averaged over two
/// pixels, MJPEG: compressed as well), mostly with a response curve; only where nothing better is there, and with a warning.
struct V4l2Format {
  enum class Kind { raw, yuyv, mjpeg };
  std::uint32_t fourcc;
  PixelLayout layout;  ///< processed formats come as mono or rgb
  int bits;
  Packing packing;     ///< of raw formats
  Kind kind = Kind::raw;
  bool processed() const { return kind != Kind::raw; }
};

/// "Y16 " of 0x20363159; bytes that do not print become '?'.
std::string fourcc_text(std::uint32_t fourcc);

/// Formats with this layout and depth, the best first; `name` (four characters) chooses one, empty: all. Processed formats are last.
std::vector<V4l2Format> v4l2_formats(PixelLayout layout, int bits, const std::string& name);

/// One image as it lies in a buffer: `stride` bytes from line to line. nullopt: too few bytes, or not a JPEG of this size.
struct BufferImage {
  std::span<const std::uint8_t> bytes;
  std::size_t stride;
  bool full_range;  ///< YUYV: Y from 0 to 255 instead of 16 to 235
};
std::optional<std::vector<std::uint16_t>> decode(const V4l2Format& format, const BufferImage& image, int width, int height);

}  // namespace lacquer::acquire
