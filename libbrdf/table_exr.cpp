#include <Imath/ImathBox.h>
#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfDoubleAttribute.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfIntAttribute.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <OpenEXR/ImfThreading.h>
#include <fmt/format.h>

#include <array>
#include <cmath>
#include <mutex>
#include <optional>
#include <thread>

#include "libbrdf/exr_header.h"
#include "libbrdf/file_error.h"
#include "libbrdf/files.h"

namespace lacquer::brdf {

namespace {

constexpr int width = TableGrid::n_phi_d * TableGrid::n_theta_d;
constexpr int height = TableGrid::n_theta_h;
constexpr int format_version = 2;  // 1: no clipped cells, otherwise the same
constexpr float float_pi = 3.14159274f;  // the float next to pi, a hair above it
constexpr std::array<const char*, 3> rgb_names{"R", "G", "B"};

/// Level 1 of zlib writes 1.6 times faster than OpenEXR's default 4 for 3 % more bytes (full table of a measured film: 13.6 MB, 1.0 s).
constexpr int zip_level = 1;

int threads() {
  // OpenEXR's pool belongs to the process and starts empty; a pool that someone else has set up is left alone.
  static std::once_flag once;
  std::call_once(once, [] {
    if (Imf::globalThreadCount() == 0) Imf::setGlobalThreadCount(static_cast<int>(std::max(1u, std::thread::hardware_concurrency())));
  });
  return std::max(1, Imf::globalThreadCount());
}

std::vector<const char*> channel_names(std::size_t n_channels) {
  if (n_channels == 1) return {"Y"};
  return {rgb_names.begin(), rgb_names.end()};
}

std::string cell_text(std::size_t i) {
  const auto c = TableGrid::cell(i);
  return fmt::format("cell (theta_h {}, theta_d {}, phi_d {})", c.theta_h, c.theta_d, c.phi_d);
}

/// The float channels of one colour, with what each value may be.
struct FloatField {
  const char* name;
  std::vector<float> TableChannel::*values;
  float min, max;
  const char* expected;
};
constexpr float float_max = std::numeric_limits<float>::max();
constexpr float quarter_turn = float_pi / 2;
constexpr std::array<FloatField, 8> float_fields{{
    {"mean", &TableChannel::mean, -float_max, float_max, "a finite number"},
    {"variance", &TableChannel::variance, 0, float_max, "a finite number >= 0"},
    {"theta_h", &TableChannel::theta_h, 0, quarter_turn, "an angle in [0, pi/2]"},
    {"theta_d", &TableChannel::theta_d, 0, quarter_turn, "an angle in [0, pi/2]"},
    {"phi_d", &TableChannel::phi_d, 0, float_pi, "an angle in [0, pi]"},
    {"footprint_along", &TableChannel::footprint_along, 0, float_max, "a finite number >= 0"},
    {"footprint_across", &TableChannel::footprint_across, 0, float_max, "a finite number >= 0"},
    {"footprint_mixed", &TableChannel::footprint_mixed, -float_max, float_max, "a finite number"},
}};

constexpr int max_channels = 3 * (static_cast<int>(float_fields.size()) + 2);  // count and origin are the two

/// What a table must fulfil to be written or believed; names the first offender.
std::optional<std::string> complaint(const TableChannel& channel, const char* colour) {
  for (const auto& field : float_fields) {
    const auto& values = channel.*field.values;
    for (std::size_t i = 0; i < values.size(); ++i) {
      if (!(values[i] >= field.min && values[i] <= field.max))
        return fmt::format("{}.{}: {}: expected {}, got {}", colour, field.name, cell_text(i), field.expected, values[i]);
      if (values[i] != 0 && channel.origin[i] == CellOrigin::empty)
        return fmt::format("{}.{}: {}: expected 0 in an empty cell, got {}", colour, field.name, cell_text(i), values[i]);
    }
  }
  for (std::size_t i = 0; i < channel.count.size(); ++i)
    if (channel.count[i] != 0 && channel.origin[i] == CellOrigin::empty)
      return fmt::format("{}.count: {}: expected 0 in an empty cell, got {}", colour, cell_text(i), channel.count[i]);
  return std::nullopt;
}

/// Adds one plane of the table, width x height values of 4 bytes each, to a frame buffer. OpenEXR wants a writable pointer also
/// for writing, which it does not use.
template <typename T>
void add_slice(Imf::FrameBuffer& buffer, const std::string& name, Imf::PixelType type, const std::vector<T>& values) {
  static_assert(sizeof(T) == 4);
  char* base = const_cast<char*>(reinterpret_cast<const char*>(values.data()));
  buffer.insert(name, Imf::Slice(type, base, sizeof(T), sizeof(T) * width));
}

/// All planes of one colour; `origin` stands in for the table's own, which has one byte per cell.
void add_colour(Imf::FrameBuffer& buffer, const std::string& colour, const TableChannel& channel, const std::vector<std::uint32_t>& origin) {
  for (const auto& field : float_fields) add_slice(buffer, colour + "." + field.name, Imf::FLOAT, channel.*field.values);
  add_slice(buffer, colour + ".count", Imf::UINT, channel.count);
  add_slice(buffer, colour + ".origin", Imf::UINT, origin);
}

void write_exr(const std::filesystem::path& file, const HalfAngleTable& table) {
  Imf::Header header(width, height);
  header.compression() = Imf::ZIPS_COMPRESSION;  // one line (1.4 MB) a block: as small as ZIP, and all threads have work
  header.zipCompressionLevel() = zip_level;
  header.insert("lacquer.version", Imf::IntAttribute(format_version));
  header.insert("lacquer.absolute_scale", Imf::IntAttribute(table.absolute_scale ? 1 : 0));
  header.insert("lacquer.scale_sigma", Imf::DoubleAttribute(table.scale_sigma));
  header.insert("lacquer.provenance", Imf::StringAttribute(table.provenance_json));

  const auto names = channel_names(table.channels.size());
  std::vector<std::vector<std::uint32_t>> origins;
  Imf::FrameBuffer buffer;
  for (const auto& channel : table.channels) {
    auto& origin = origins.emplace_back(TableGrid::n_cells);
    for (std::size_t i = 0; i < origin.size(); ++i) origin[i] = static_cast<std::uint32_t>(channel.origin[i]);
    add_colour(buffer, names[origins.size() - 1], channel, origin);
  }
  for (auto slice = buffer.begin(); slice != buffer.end(); ++slice)
    header.channels().insert(slice.name(), Imf::Channel(slice.slice().type));
  Imf::OutputFile out(file.c_str(), header, threads());
  out.setFrameBuffer(buffer);
  out.writePixels(height);
}

template <typename Attribute>
auto attribute(const std::filesystem::path& file, const Imf::Header& header, const char* name) {
  const auto* found = header.findTypedAttribute<Attribute>(name);
  if (!found) fail_file(file, fmt::format("attribute {} is missing or has the wrong type: not a table of Lacquer", name));
  return found->value();
}

void check_channels(const std::filesystem::path& file, const Imf::Header& header, const Imf::FrameBuffer& wanted) {
  for (auto slice = wanted.begin(); slice != wanted.end(); ++slice) {
    const Imf::Channel* channel = header.channels().findChannel(slice.name());
    if (!channel) fail_file(file, fmt::format("channel {} is missing", slice.name()));
    if (channel->type != slice.slice().type)
      fail_file(file, fmt::format("channel {}: expected 32-bit {}", slice.name(), slice.slice().type == Imf::FLOAT ? "float" : "uint"));
    if (channel->xSampling != 1 || channel->ySampling != 1)
      fail_file(file, fmt::format("channel {}: expected one value per pixel, got a subsampled channel", slice.name()));
  }
}

HalfAngleTable read_exr(const std::filesystem::path& file) {
  Imf::InputFile in(file.c_str(), threads());
  const Imf::Header& header = in.header();
  const int version = attribute<Imf::IntAttribute>(file, header, "lacquer.version");
  if (version < 1 || version > format_version)
    fail_file(file, fmt::format("lacquer.version: expected at most {}, got {}: written by another version of Lacquer", format_version, version));

  HalfAngleTable table(header.channels().findChannel("Y.mean") ? 1 : 3);
  table.absolute_scale = attribute<Imf::IntAttribute>(file, header, "lacquer.absolute_scale") != 0;
  if (header.find("lacquer.scale_sigma") != header.end()) {  // tables from before it was known do not have it
    table.scale_sigma = attribute<Imf::DoubleAttribute>(file, header, "lacquer.scale_sigma");
    if (!(table.scale_sigma >= 0 && table.scale_sigma < 10)) fail_file(file, "lacquer.scale_sigma: expected a number from 0 to 10");
  }
  table.provenance_json = attribute<Imf::StringAttribute>(file, header, "lacquer.provenance");

  const auto names = channel_names(table.channels.size());
  std::vector<std::vector<std::uint32_t>> origins(table.channels.size(), std::vector<std::uint32_t>(TableGrid::n_cells));
  Imf::FrameBuffer buffer;
  for (std::size_t c = 0; c < names.size(); ++c) add_colour(buffer, names[c], table.channels[c], origins[c]);
  check_channels(file, header, buffer);
  in.setFrameBuffer(buffer);
  in.readPixels(0, height - 1);

  const auto last_origin = static_cast<std::uint32_t>(version == 1 ? CellOrigin::modelled : CellOrigin::clipped);
  for (std::size_t c = 0; c < names.size(); ++c) {
    auto& channel = table.channels[c];
    for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
      if (origins[c][i] > last_origin)
        fail_file(file, fmt::format("{}.origin: {}: expected 0 to {}, got {}", names[c], cell_text(i), last_origin, origins[c][i]));
      channel.origin[i] = static_cast<CellOrigin>(origins[c][i]);
    }
    if (const auto what = complaint(channel, names[c])) fail_file(file, *what);
  }
  return table;
}

}  // namespace

void write_table(const std::filesystem::path& file, const HalfAngleTable& table) {
  const std::size_t n_channels = table.channels.size();
  if (n_channels != 1 && n_channels != 3)
    throw Error(ErrorCode::input, fmt::format("{}: expected a table of 1 or 3 channels, got {}", file.string(), n_channels));
  const auto names = channel_names(n_channels);
  for (std::size_t c = 0; c < n_channels; ++c)
    if (const auto what = complaint(table.channels[c], names[c]))
      throw Error(ErrorCode::input, fmt::format("{}: table cannot be written: {}", file.string(), *what));
  write_atomically(file, [&](const std::filesystem::path& temporary) {
    try {
      write_exr(temporary, table);
    } catch (const Error&) {
      throw;
    } catch (const std::exception& e) {
      fail_file(file, fmt::format("cannot be written: {}", e.what()));
    }
  });
}

HalfAngleTable read_table(const std::filesystem::path& file) {
  check_exr_header(file, {.width = width, .height = height, .max_channels = max_channels, .what = "a table of Lacquer"});
  try {
    return read_exr(file);
  } catch (const Error&) {
    throw;
  } catch (const std::exception& e) {
    fail_file(file, fmt::format("is not a readable OpenEXR file: {}", e.what()));
  }
}

}  // namespace lacquer::brdf
