#include "libcalib/radiance_image.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfIntAttribute.h>
#include <ImfOutputFile.h>
#include <ImfStringAttribute.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::calib {

namespace {

constexpr const char* layout_attribute = "lacquer.layout";
constexpr const char* version_attribute = "lacquer.version";
constexpr int file_version = 1;
constexpr int max_side = 32768;
constexpr std::int64_t max_values = std::int64_t{1} << 28;  ///< 3 GiB of radiance, variance and flags

/// Measured on a merged sphere, 1360 x 1024 rgb with noise (two thirds of it black), write / read / size: none 0.08 s / 0.19 s / 50 MB,
/// RLE 0.31 / 0.33 / 38, ZIPS 1.43 / 0.54 / 31, ZIP 1.66 / 0.55 / 30, PIZ 1.43 / 0.65 / 32. Noise does not pack; merging takes 0.12 s.
constexpr Imf::Compression compression = Imf::NO_COMPRESSION;

[[noreturn]] void fail(const std::filesystem::path& file, const std::string& what) {
  throw Error(ErrorCode::file, file.string() + ": " + what);
}

std::vector<std::string> channel_names(acquire::PixelLayout layout) {
  if (layout == acquire::PixelLayout::rgb) return {"R", "G", "B"};
  return {"Y"};
}

/// The planes of one file in memory; flags as OpenEXR's 32-bit unsigned integers.
struct Planes {
  float* radiance;
  float* variance;
  unsigned* flags;
};

Imf::FrameBuffer frame_buffer(const std::vector<std::string>& names, int width, const Planes& planes) {
  Imf::FrameBuffer buffer;
  const std::size_t n = names.size(), row = n * static_cast<std::size_t>(width);
  const auto slice = [&](Imf::PixelType type, void* base, std::size_t size) {
    return Imf::Slice(type, static_cast<char*>(base), n * size, row * size);
  };
  for (std::size_t k = 0; k < n; ++k) {
    buffer.insert(names[k], slice(Imf::FLOAT, planes.radiance + k, sizeof(float)));
    buffer.insert(names[k] + ".variance", slice(Imf::FLOAT, planes.variance + k, sizeof(float)));
    buffer.insert(names[k] + ".flag", slice(Imf::UINT, planes.flags + k, sizeof(unsigned)));
  }
  return buffer;
}

void check_image(const RadianceImage& image) {
  const std::size_t n = static_cast<std::size_t>(std::max(image.width, 0)) * static_cast<std::size_t>(std::max(image.height, 0)) *
                        static_cast<std::size_t>(acquire::values_per_pixel(image.layout));
  if (n == 0 || image.radiance.size() != n || image.variance.size() != n || image.flags.size() != n)
    throw Error(ErrorCode::input, fmt::format("radiance image: expected {} radiances, variances and flags, got {}, {} and {}", n,
                                              image.radiance.size(), image.variance.size(), image.flags.size()));
}

acquire::PixelLayout read_layout(const Imf::Header& header, const std::filesystem::path& file) {
  const auto* version = header.findTypedAttribute<Imf::IntAttribute>(version_attribute);
  if (!version) fail(file, fmt::format("{}: expected {}, it is missing; not a radiance image of lacquer merge", version_attribute, file_version));
  if (version->value() != file_version)
    fail(file, fmt::format("{}: expected {}, got {}", version_attribute, file_version, version->value()));
  const auto* layout = header.findTypedAttribute<Imf::StringAttribute>(layout_attribute);
  if (!layout) fail(file, fmt::format("{}: expected the name of a pixel layout, it is missing", layout_attribute));
  try {
    return acquire::pixel_layout_from_name(layout->value());
  } catch (const Error& e) {
    fail(file, fmt::format("{}: {}", layout_attribute, e.what()));
  }
}

void check_channel(const Imf::Header& header, const std::string& name, Imf::PixelType type, const std::filesystem::path& file) {
  const Imf::Channel* channel = header.channels().findChannel(name);
  if (!channel) fail(file, fmt::format("channel {}: expected, it is missing", name));
  if (channel->type != type || channel->xSampling != 1 || channel->ySampling != 1)
    fail(file, fmt::format("channel {}: expected {} without subsampling", name, type == Imf::FLOAT ? "32-bit float" : "32-bit unsigned"));
}

/// Size from the header, checked before anything is allocated from it.
void read_size(const Imf::Header& header, RadianceImage& image, const std::filesystem::path& file) {
  const auto& window = header.dataWindow();
  const std::int64_t width = std::int64_t{window.max.x} - window.min.x + 1, height = std::int64_t{window.max.y} - window.min.y + 1;
  if (window.min.x != 0 || window.min.y != 0) fail(file, "dataWindow: expected to start at (0, 0)");
  if (width < 1 || height < 1 || width > max_side || height > max_side || width * height > max_values / 3)
    fail(file, fmt::format("dataWindow: expected at most {} pixels a side and {} in all, got {} x {}", max_side, max_values / 3, width, height));
  if (header.compression() != compression) fail(file, "compression: expected none, as lacquer merge writes it");
  const std::uint64_t claimed = static_cast<std::uint64_t>(width * height) * 12;
  if (claimed > std::filesystem::file_size(file))
    fail(file, fmt::format("dataWindow: {} x {} pixels do not fit a file of {} bytes", width, height, std::filesystem::file_size(file)));
  image.width = static_cast<int>(width);
  image.height = static_cast<int>(height);
}

void check_values(const RadianceImage& image, const std::vector<unsigned>& flags, const std::filesystem::path& file) {
  for (std::size_t i = 0; i < flags.size(); ++i) {
    const char* wrong = nullptr;
    if (!std::isfinite(image.radiance[i])) wrong = "radiance: expected a finite number";
    if (!std::isfinite(image.variance[i]) || image.variance[i] < 0) wrong = "variance: expected a finite number >= 0";
    if (flags[i] > static_cast<unsigned>(PixelFlag::invalid)) wrong = "flag: expected 0 to 3";
    if (!wrong) continue;
    const std::size_t pixel = i / static_cast<std::size_t>(acquire::values_per_pixel(image.layout));
    fail(file, fmt::format("pixel ({}, {}): {}", pixel % static_cast<std::size_t>(image.width),
                           pixel / static_cast<std::size_t>(image.width), wrong));
  }
}

/// OpenEXR takes over a line shorter than the header claims and leaves the rest of its buffer as it was: check every line first.
void check_lines(Imf::InputFile& in, const RadianceImage& image, const std::filesystem::path& file) {
  int channels = 0;
  for (auto c = in.header().channels().begin(); c != in.header().channels().end(); ++c) {
    if (c.channel().type == Imf::HALF || c.channel().xSampling != 1 || c.channel().ySampling != 1)
      fail(file, fmt::format("channel {}: expected 32 bits without subsampling", c.name()));
    ++channels;
  }
  const std::int64_t expected = std::int64_t{4} * channels * image.width;
  for (int y = 0; y < image.height; ++y) {
    const char* data = nullptr;
    int size = 0;
    in.rawPixelData(y, data, size);
    if (size != expected) fail(file, fmt::format("line {}: expected {} bytes, got {}", y, expected, size));
  }
}

RadianceImage read_checked(const std::filesystem::path& file) {
  Imf::InputFile in(file.c_str());
  RadianceImage image;
  image.layout = read_layout(in.header(), file);
  const auto names = channel_names(image.layout);
  for (const std::string& name : names) {
    check_channel(in.header(), name, Imf::FLOAT, file);
    check_channel(in.header(), name + ".variance", Imf::FLOAT, file);
    check_channel(in.header(), name + ".flag", Imf::UINT, file);
  }
  read_size(in.header(), image, file);
  check_lines(in, image, file);
  const std::size_t n = static_cast<std::size_t>(image.width) * static_cast<std::size_t>(image.height) * names.size();
  image.radiance.resize(n);
  image.variance.resize(n);
  std::vector<unsigned> flags(n);
  in.setFrameBuffer(frame_buffer(names, image.width, {image.radiance.data(), image.variance.data(), flags.data()}));
  in.readPixels(0, image.height - 1);
  check_values(image, flags, file);
  image.flags.resize(n);
  std::transform(flags.begin(), flags.end(), image.flags.begin(), [](unsigned f) { return static_cast<PixelFlag>(f); });
  return image;
}

}  // namespace

void write_radiance(const std::filesystem::path& file, const RadianceImage& image) {
  check_image(image);
  std::vector<unsigned> flags(image.flags.size());
  std::transform(image.flags.begin(), image.flags.end(), flags.begin(), [](PixelFlag f) { return static_cast<unsigned>(f); });
  // OpenEXR only reads through the pointers of an output frame buffer but does not take const ones.
  const Planes planes{const_cast<float*>(image.radiance.data()), const_cast<float*>(image.variance.data()), flags.data()};
  const auto names = channel_names(image.layout);
  Imf::Header header(image.width, image.height, 1, Imath::V2f(0, 0), 1, Imf::INCREASING_Y, compression);
  header.insert(version_attribute, Imf::IntAttribute(file_version));
  header.insert(layout_attribute, Imf::StringAttribute(acquire::name_of(image.layout)));
  for (const std::string& name : names) {
    header.channels().insert(name, Imf::Channel(Imf::FLOAT));
    header.channels().insert(name + ".variance", Imf::Channel(Imf::FLOAT));
    header.channels().insert(name + ".flag", Imf::Channel(Imf::UINT));
  }
  brdf::write_atomically(file, [&](const std::filesystem::path& temporary) {
    try {
      Imf::OutputFile out(temporary.c_str(), header);
      out.setFrameBuffer(frame_buffer(names, image.width, planes));
      out.writePixels(image.height);
    } catch (const std::exception& e) {
      fail(file, fmt::format("cannot be written: {}", e.what()));
    }
  });
}

RadianceImage read_radiance(const std::filesystem::path& file) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error)) fail(file, "expected a radiance image (EXR), there is no such file");
  try {
    return read_checked(file);
  } catch (const Error&) {
    throw;
  } catch (const std::exception& e) {
    fail(file, fmt::format("expected a radiance image (EXR): {}", e.what()));
  }
}

}  // namespace lacquer::calib
