#include "libacquire/image_header.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstdint>

#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

/// No camera of this field has more; keeps a forged header from asking for all memory.
constexpr std::uint64_t max_pixels = std::uint64_t{1} << 27;

[[noreturn]] void fail(const std::string& name, const std::string& what) { throw Error(ErrorCode::file, name + ": " + what); }

/// Bounds-checked view of the file in either byte order.
class Bytes {
 public:
  Bytes(std::span<const std::byte> data, const std::string& name, bool big_endian)
      : data_(data), name_(name), big_endian_(big_endian) {}

  std::uint64_t size() const { return data_.size(); }
  const std::string& name() const { return name_; }
  bool holds(std::uint64_t offset, std::uint64_t length) const {
    return offset <= data_.size() && length <= data_.size() - offset;
  }
  std::uint32_t u8(std::uint64_t at) const { return static_cast<std::uint32_t>(get(at, 1)); }
  std::uint32_t u16(std::uint64_t at) const { return static_cast<std::uint32_t>(get(at, 2)); }
  std::uint32_t u32(std::uint64_t at) const { return static_cast<std::uint32_t>(get(at, 4)); }
  std::span<const std::byte> part(std::uint64_t offset, std::uint64_t length) const {
    need(offset, length);
    return data_.subspan(offset, length);
  }

 private:
  void need(std::uint64_t offset, std::uint64_t length) const {
    if (!holds(offset, length))
      fail(name_, fmt::format("file is cut short: {} bytes, expected at least {}", data_.size(), offset + length));
  }
  std::uint64_t get(std::uint64_t at, std::uint64_t n) const {
    need(at, n);
    std::uint64_t value = 0;
    for (std::uint64_t i = 0; i < n; ++i)
      value = value << 8 | std::to_integer<std::uint64_t>(data_[big_endian_ ? at + i : at + n - 1 - i]);
    return value;
  }

  std::span<const std::byte> data_;
  const std::string& name_;
  bool big_endian_;
};

/// Common to all formats, once the numbers are known.
ImageHeader checked(const std::string& name, std::uint64_t width, std::uint64_t height, std::uint64_t bits,
                    std::uint64_t channels) {
  if (width == 0 || height == 0 || width > max_pixels || height > max_pixels || width * height > max_pixels)
    fail(name, fmt::format("image of {} x {} pixels; expected at least 1 x 1 and at most {} pixels", width, height, max_pixels));
  if (channels == 2 || channels == 4) fail(name, "image has an alpha channel; expected grey or RGB without alpha");
  if (channels != 1 && channels != 3) fail(name, fmt::format("image has {} channels; expected 1 (grey) or 3 (RGB)", channels));
  if (bits != 8 && bits != 16) fail(name, fmt::format("image has {} bits per value; expected 8 or 16", bits));
  return {static_cast<int>(width), static_cast<int>(height), static_cast<int>(bits), static_cast<int>(channels)};
}

/// CRC-32 of PNG (ISO 3309, PNG specification annex D).
std::uint32_t png_crc(std::span<const std::byte> bytes) {
  static const auto table = [] {
    std::array<std::uint32_t, 256> t{};
    for (std::uint32_t n = 0; n < 256; ++n) {
      std::uint32_t c = n;
      for (int k = 0; k < 8; ++k) c = (c & 1u) ? 0xedb88320u ^ (c >> 1) : c >> 1;
      t[n] = c;
    }
    return t;
  }();
  std::uint32_t crc = 0xffffffffu;
  for (const std::byte b : bytes) crc = table[(crc ^ std::to_integer<std::uint32_t>(b)) & 0xffu] ^ (crc >> 8);
  return crc ^ 0xffffffffu;
}

constexpr std::uint32_t chunk_type(const char (&t)[5]) {
  return std::uint32_t(t[0]) << 24 | std::uint32_t(t[1]) << 16 | std::uint32_t(t[2]) << 8 | std::uint32_t(t[3]);
}

ImageHeader png_header(const Bytes& file) {
  const std::string& name = file.name();
  std::uint64_t at = 8;
  bool data_seen = false;
  ImageHeader header;
  for (;;) {
    const std::uint64_t length = file.u32(at);
    const std::uint32_t type = file.u32(at + 4);
    const auto typed = file.part(at + 4, length + 4);
    if (png_crc(typed) != file.u32(at + 8 + length)) fail(name, fmt::format("PNG is damaged: wrong checksum at byte {}", at));
    if (at == 8) {
      if (type != chunk_type("IHDR") || length != 13) fail(name, "PNG is damaged: it does not begin with its header");
      const std::uint32_t color = file.u8(at + 17);
      if (color == 3) fail(name, "PNG has a palette; expected grey or RGB");
      if (color != 0 && color != 2 && color != 4 && color != 6) fail(name, fmt::format("PNG has unknown colour type {}", color));
      header = checked(name, file.u32(at + 8), file.u32(at + 12), file.u8(at + 16),
                       color == 0 ? 1 : color == 2 ? 3 : color == 4 ? 2 : 4);
    }
    if (type == chunk_type("tRNS")) fail(name, "PNG has transparent pixels; expected grey or RGB without alpha");
    if (type == chunk_type("IDAT")) data_seen = true;
    if (type == chunk_type("IEND")) break;
    at += 12 + length;
  }
  if (!data_seen) fail(name, "PNG has no image data");
  return header;
}

/// Entry of a TIFF directory whose values are unsigned shorts or longs.
class TiffField {
 public:
  TiffField(const Bytes& file, std::uint64_t entry) : file_(file), tag_(file.u16(entry)), size_(file.u16(entry + 2) == 3 ? 2 : 4) {
    const std::uint32_t type = file.u16(entry + 2);
    count_ = file.u32(entry + 4);
    if (type != 3 && type != 4) fail(file.name(), fmt::format("TIFF is damaged: tag {} has type {}, expected short or long", tag_, type));
    at_ = count_ * size_ <= 4 ? entry + 8 : file.u32(entry + 8);
    if (count_ == 0 || !file.holds(at_, count_ * size_)) fail(file.name(), fmt::format("file is cut short: TIFF tag {} lies outside", tag_));
  }
  std::uint64_t count() const { return count_; }
  std::uint32_t operator[](std::uint64_t i) const { return size_ == 2 ? file_.u16(at_ + 2 * i) : file_.u32(at_ + 4 * i); }

 private:
  const Bytes& file_;
  std::uint32_t tag_;
  std::uint64_t size_, count_ = 0, at_ = 0;
};

/// Where the pixels lie: strips or tiles, all inside the file.
void check_tiff_strips(const Bytes& file, const TiffField& offsets, const TiffField& counts) {
  if (offsets.count() != counts.count()) fail(file.name(), "TIFF is damaged: as many strip sizes as strips are needed");
  for (std::uint64_t i = 0; i < offsets.count(); ++i)
    if (!file.holds(offsets[i], counts[i]))
      fail(file.name(), fmt::format("file is cut short: {} bytes, strip {} of {} ends at byte {}", file.size(), i, offsets.count(),
                                    std::uint64_t{offsets[i]} + counts[i]));
}

/// First directory of a TIFF.
class TiffDirectory {
 public:
  explicit TiffDirectory(const Bytes& file) : file_(file), at_(file.u32(4)), n_entries_(file.u16(at_)) {}
  bool has(std::uint32_t tag) const { return find(tag) != 0; }
  TiffField required(std::uint32_t tag, const char* what) const {
    if (!has(tag)) fail(file_.name(), fmt::format("TIFF is damaged: no {}", what));
    return TiffField(file_, find(tag));
  }
  std::uint32_t number(std::uint32_t tag, std::uint32_t absent) const { return has(tag) ? TiffField(file_, find(tag))[0] : absent; }

 private:
  std::uint64_t find(std::uint32_t tag) const {
    for (std::uint64_t i = 0; i < n_entries_; ++i)
      if (file_.u16(at_ + 2 + 12 * i) == tag) return at_ + 2 + 12 * i;
    return 0;
  }
  const Bytes& file_;
  std::uint64_t at_, n_entries_;
};

/// Strips or tiles are complete: the decoder would return what is there and leave the rest grey.
void check_tiff_layout(const Bytes& file, const TiffDirectory& directory, const ImageHeader& header, bool compressed) {
  const std::string& name = file.name();
  if (directory.has(324)) return check_tiff_strips(file, directory.required(324, "tiles"), directory.required(325, "tile sizes"));
  const TiffField strips = directory.required(273, "strips"), sizes = directory.required(279, "strip sizes");
  check_tiff_strips(file, strips, sizes);
  const auto height = static_cast<std::uint64_t>(header.height), channels = static_cast<std::uint64_t>(header.channels);
  const std::uint64_t rows = std::min<std::uint64_t>(directory.number(278, 0xffffffffu), height);  // of one strip
  const bool separate_planes = directory.number(284, 1) == 2;
  const std::uint64_t strips_per_plane = rows == 0 ? 0 : (height + rows - 1) / rows;
  if (rows == 0 || strips.count() != strips_per_plane * (separate_planes ? channels : 1))
    fail(name, fmt::format("TIFF is damaged: {} strips of {} rows for {} rows", strips.count(), rows, height));
  if (compressed) return;
  const std::uint64_t row_bytes = static_cast<std::uint64_t>(header.width) * (separate_planes ? 1 : channels) * (header.bits / 8u);
  for (std::uint64_t i = 0; i < strips.count(); ++i) {
    const std::uint64_t first_row = (i % strips_per_plane) * rows;
    const std::uint64_t expected = std::min(rows, height - first_row) * row_bytes;
    if (sizes[i] < expected) fail(name, fmt::format("file is cut short: strip {} has {} bytes, expected {}", i, sizes[i], expected));
  }
}

ImageHeader tiff_header(const Bytes& file) {
  const std::string& name = file.name();
  if (file.u16(2) != 42) fail(name, "this kind of TIFF (BigTIFF) is not supported; expected a classic TIFF");
  const TiffDirectory directory(file);
  const std::uint32_t channels = directory.number(277, 1);
  const ImageHeader header = checked(name, directory.required(256, "width")[0], directory.required(257, "height")[0],
                                     directory.required(258, "bits per sample")[0], channels);
  if (directory.number(339, 1) != 1) fail(name, "TIFF has signed or floating-point values; expected unsigned integers");
  const std::uint32_t photometric = directory.required(262, "photometric interpretation")[0];
  if (photometric != (channels == 1 ? 1u : 2u))
    fail(name, fmt::format("TIFF has photometric interpretation {}; expected grey (1) or RGB (2)", photometric));
  const std::uint32_t compression = directory.number(259, 1);
  constexpr std::array<std::uint32_t, 5> lossless = {1, 5, 8, 32773, 32946};  // none, LZW, Deflate, PackBits, Deflate (old number)
  if (std::find(lossless.begin(), lossless.end(), compression) == lossless.end())
    fail(name, fmt::format("TIFF has compression {}; expected none, LZW, Deflate or PackBits", compression));
  check_tiff_layout(file, directory, header, compression != 1);
  return header;
}

ImageHeader pnm_header(const Bytes& file) {
  const std::string& name = file.name();
  const std::uint64_t channels = file.u8(1) == '5' ? 1 : 3;
  std::uint64_t at = 2;
  const auto token = [&]() -> std::uint64_t {
    for (;; ++at) {
      if (file.u8(at) == '#')
        while (file.u8(at) != '\n') ++at;
      if (file.u8(at) != ' ' && file.u8(at) != '\t' && file.u8(at) != '\n' && file.u8(at) != '\r') break;
    }
    std::uint64_t value = 0;
    const std::uint64_t begin = at;
    while (file.u8(at) >= '0' && file.u8(at) <= '9' && at - begin < 10) value = 10 * value + (file.u8(at++) - '0');
    if (at == begin) fail(name, "PGM/PPM header is damaged: expected width, height and largest value");
    return value;
  };
  const std::uint64_t width = token(), height = token(), largest = token();
  if (largest < 255 || largest > 65535) fail(name, fmt::format("PGM/PPM with largest value {}; expected 255 to 65535", largest));
  const ImageHeader header = checked(name, width, height, largest > 255 ? 16 : 8, channels);
  const std::uint64_t expected = width * height * channels * (header.bits / 8u);
  if (!file.holds(at + 1, expected))
    fail(name, fmt::format("file is cut short: {} bytes of pixels, expected {}", file.size() - std::min(file.size(), at + 1), expected));
  return header;
}

ImageHeader jpeg_header(const Bytes& file) {
  const std::string& name = file.name();
  std::uint64_t end = file.size();
  while (end > 4 && file.u8(end - 1) == 0) --end;  // some cameras pad with zeros
  if (file.u8(end - 2) != 0xff || file.u8(end - 1) != 0xd9) fail(name, "file is cut short: the JPEG has no end marker");
  std::uint64_t at = 2;
  for (;;) {
    if (file.u8(at) != 0xff) fail(name, fmt::format("JPEG is damaged: expected a marker at byte {}", at));
    const std::uint32_t marker = file.u8(at + 1);
    const bool frame = marker >= 0xc0 && marker <= 0xcf && marker != 0xc4 && marker != 0xc8 && marker != 0xcc;
    if (frame) return checked(name, file.u16(at + 7), file.u16(at + 5), file.u8(at + 4), file.u8(at + 9));
    if (marker == 0xda || marker == 0xd9) fail(name, "JPEG is damaged: no frame header before the image data");
    at += marker == 0xff ? 1 : 2 + std::uint64_t{file.u16(at + 2)};
  }
}

}  // namespace

ImageHeader read_image_header(std::span<const std::byte> bytes, const std::string& name) {
  const Bytes big(bytes, name, true), little(bytes, name, false);
  if (bytes.empty()) fail(name, "file is empty; expected an image");
  if (bytes.size() >= 12) {
    if (big.u32(0) == 0x89504e47 && big.u32(4) == 0x0d0a1a0a) return png_header(big);
    if (big.u32(0) == 0x49492a00 || big.u32(0) == 0x49492b00) return tiff_header(little);
    if (big.u32(0) == 0x4d4d002a || big.u32(0) == 0x4d4d002b) return tiff_header(big);
    if (big.u16(0) == 0x5035 || big.u16(0) == 0x5036) return pnm_header(big);
    if (big.u16(0) == 0xffd8) return jpeg_header(big);
  }
  fail(name, "not an image that holds raw counts; expected PNG, TIFF, binary PGM/PPM or JPEG");
}

}  // namespace lacquer::acquire
