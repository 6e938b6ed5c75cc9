#include "libcalib/mosaic_exr.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfIntAttribute.h>
#include <ImfOutputFile.h>
#include <ImfStringAttribute.h>
#include <fmt/format.h>

#include <bit>
#include <cstring>
#include <map>

#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::calib {

namespace {

constexpr const char* layout_attribute = "lacquer.layout";
constexpr int max_side = 32768;
constexpr std::int64_t max_values = std::int64_t{1} << 28;  ///< 3 GiB of three planes

/// Measured on a merged sphere, 1360 x 1024 rgb with noise (two thirds of it black), write / read / size: none 0.08 s / 0.19 s / 50 MB,
/// RLE 0.31 / 0.33 / 38, ZIPS 1.43 / 0.54 / 31, ZIP 1.66 / 0.55 / 30, PIZ 1.43 / 0.65 / 32. Noise does not pack; merging takes 0.12 s.
constexpr Imf::Compression compression = Imf::NO_COMPRESSION;

[[noreturn]] void fail_file(const std::filesystem::path& file, const std::string& what) {
  throw Error(ErrorCode::file, file.string() + ": " + what);
}

std::vector<std::string> channel_names(acquire::PixelLayout layout) {
  if (layout == acquire::PixelLayout::rgb) return {"R", "G", "B"};
  return {"Y"};
}

Imf::FrameBuffer frame_buffer(acquire::PixelLayout layout, int width, const std::vector<MosaicPlane>& planes) {
  constexpr std::size_t size = 4;  // bytes of a float or an unsigned integer
  Imf::FrameBuffer buffer;
  const auto names = channel_names(layout);
  const std::size_t n = names.size(), row = n * static_cast<std::size_t>(width);
  for (std::size_t k = 0; k < n; ++k)
    for (const MosaicPlane& plane : planes)
      buffer.insert(names[k] + plane.suffix, Imf::Slice(plane.type, static_cast<char*>(plane.data) + k * size, n * size, row * size));
  return buffer;
}

acquire::PixelLayout read_layout(const Imf::Header& header, const MosaicExrKind& kind, const std::filesystem::path& file) {
  const auto* version = header.findTypedAttribute<Imf::IntAttribute>(kind.version_attribute);
  if (!version) fail_file(file, fmt::format("{}: expected {}, it is missing; not {}", kind.version_attribute, kind.version, kind.what));
  if (version->value() != kind.version)
    fail_file(file, fmt::format("{}: expected {}, got {}", kind.version_attribute, kind.version, version->value()));
  const auto* layout = header.findTypedAttribute<Imf::StringAttribute>(layout_attribute);
  if (!layout) fail_file(file, fmt::format("{}: expected the name of a pixel layout, it is missing", layout_attribute));
  try {
    return acquire::pixel_layout_from_name(layout->value());
  } catch (const Error& e) {
    fail_file(file, fmt::format("{}: {}", layout_attribute, e.what()));
  }
}

}  // namespace

void write_mosaic_exr(const std::filesystem::path& file, const MosaicExrKind& kind, int width, int height, acquire::PixelLayout layout,
                      const std::vector<MosaicPlane>& planes, const std::function<void(Imf::Header&)>& add_attributes) {
  Imf::Header header(width, height, 1, Imath::V2f(0, 0), 1, Imf::INCREASING_Y, compression);
  header.insert(kind.version_attribute, Imf::IntAttribute(kind.version));
  header.insert(layout_attribute, Imf::StringAttribute(acquire::name_of(layout)));
  if (add_attributes) add_attributes(header);
  for (const std::string& name : channel_names(layout))
    for (const MosaicPlane& plane : planes) header.channels().insert(name + plane.suffix, Imf::Channel(plane.type));
  brdf::write_atomically(file, [&](const std::filesystem::path& temporary) {
    try {
      Imf::OutputFile out(temporary.c_str(), header);
      out.setFrameBuffer(frame_buffer(layout, width, planes));
      out.writePixels(height);
    } catch (const std::exception& e) {
      fail_file(file, fmt::format("cannot be written: {}", e.what()));
    }
  });
}

MosaicExrReader::MosaicExrReader(const std::filesystem::path& file, const MosaicExrKind& kind) : file_(file), kind_(kind), in_(file.c_str()) {
  layout_ = read_layout(in_.header(), kind, file);
  read_size();
  check_channels();
}

std::size_t MosaicExrReader::n_values() const {
  return static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_) *
         static_cast<std::size_t>(acquire::values_per_pixel(layout_));
}

/// Size from the header, checked before anything is allocated from it.
void MosaicExrReader::read_size() {
  const auto& window = header().dataWindow();
  const std::int64_t width = std::int64_t{window.max.x} - window.min.x + 1, height = std::int64_t{window.max.y} - window.min.y + 1;
  if (window.min.x != 0 || window.min.y != 0) fail("dataWindow: expected to start at (0, 0)");
  if (width < 1 || height < 1 || width > max_side || height > max_side || width * height > max_values / 3)
    fail(fmt::format("dataWindow: expected at most {} pixels a side and {} in all, got {} x {}", max_side, max_values / 3, width, height));
  if (header().compression() != compression) fail(fmt::format("compression: expected none; not {}", kind_.what));
  int n_channels = 0;
  for (auto c = header().channels().begin(); c != header().channels().end(); ++c) ++n_channels;
  const std::uint64_t claimed = static_cast<std::uint64_t>(width * height) * 4 * static_cast<std::uint64_t>(n_channels);
  if (claimed > std::filesystem::file_size(file_))
    fail(fmt::format("dataWindow: {} x {} pixels do not fit a file of {} bytes", width, height, std::filesystem::file_size(file_)));
  width_ = static_cast<int>(width);
  height_ = static_cast<int>(height);
}

void MosaicExrReader::check_channels() {
  for (auto c = header().channels().begin(); c != header().channels().end(); ++c)
    if (c.channel().type == Imf::HALF || c.channel().xSampling != 1 || c.channel().ySampling != 1)
      fail(fmt::format("channel {}: expected 32 bits without subsampling", c.name()));
}

bool MosaicExrReader::has(const std::string& suffix) const {
  return header().channels().findChannel(channel_names(layout_).front() + suffix) != nullptr;
}

/// Line by line as the file has them: little-endian, one channel after the other. OpenEXR's own way takes every value of an uncompressed
/// file apart into bytes, ten times as slowly, and takes over a line that is shorter than the header claims.
void MosaicExrReader::read(const std::vector<MosaicPlane>& planes) {
  static_assert(std::endian::native == std::endian::little);
  constexpr std::size_t size = 4;
  std::map<std::string, std::size_t> place;  // of a channel in a line
  for (auto c = header().channels().begin(); c != header().channels().end(); ++c) place.emplace(c.name(), place.size());
  const auto names = channel_names(layout_);
  const std::size_t n = names.size(), width = static_cast<std::size_t>(width_);
  for (const std::string& name : names)
    for (const MosaicPlane& plane : planes) {
      const Imf::Channel* channel = header().channels().findChannel(name + plane.suffix);
      if (!channel) fail(fmt::format("channel {}: expected, it is missing", name + plane.suffix));
      if (channel->type != plane.type)
        fail(fmt::format("channel {}: expected {}", name + plane.suffix, plane.type == Imf::FLOAT ? "32-bit float" : "32-bit unsigned"));
    }
  const std::size_t expected = size * place.size() * width;
  for (int y = 0; y < height_; ++y) {
    const char* line = nullptr;
    int line_size = 0;
    in_.rawPixelData(y, line, line_size);
    if (line_size < 0 || static_cast<std::size_t>(line_size) != expected) fail(fmt::format("line {}: expected {} bytes, got {}", y, expected, line_size));
    for (std::size_t k = 0; k < n; ++k)
      for (const MosaicPlane& plane : planes) {
        const char* from = line + size * width * place.at(names[k] + plane.suffix);
        char* to = static_cast<char*>(plane.data) + size * n * width * static_cast<std::size_t>(y);
        if (n == 1)
          std::memcpy(to, from, size * width);
        else
          for (std::size_t x = 0; x < width; ++x) std::memcpy(to + size * (n * x + k), from + size * x, size);
      }
  }
}

void MosaicExrReader::fail(const std::string& what) const { fail_file(file_, what); }

void MosaicExrReader::fail_at(std::size_t index, const std::string& what) const {
  const std::size_t pixel = index / static_cast<std::size_t>(acquire::values_per_pixel(layout_)), width = static_cast<std::size_t>(width_);
  fail(fmt::format("pixel ({}, {}): {}", pixel % width, pixel / width, what));
}

void reading_mosaic_exr(const std::filesystem::path& file, const std::string& what, const std::function<void()>& read) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error)) fail_file(file, fmt::format("expected {} (EXR), there is no such file", what));
  try {
    read();
  } catch (const Error&) {
    throw;
  } catch (const std::exception& e) {
    fail_file(file, fmt::format("expected {} (EXR): {}", what, e.what()));
  }
}

}  // namespace lacquer::calib
