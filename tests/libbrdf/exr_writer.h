#pragma once

#include <map>
#include <string>
#include <vector>

#include "libbrdf/table.h"
#include "tests/libbrdf/file_test_support.h"

namespace lacquer::test {

/// A table as an uncompressed OpenEXR file, byte by byte from "OpenEXR File Layout", independently of the library that reads it.
/// Every part can be bent before content() is called.
struct ExrWriter {
  struct Channel {
    std::int32_t type;  ///< 0 uint, 1 half, 2 float
    std::vector<std::uint32_t> bits = std::vector<std::uint32_t>(brdf::TableGrid::n_cells);
    std::int32_t sampling = 1;
  };
  std::map<std::string, Channel> channels;  ///< the file wants them sorted by name
  std::vector<std::int32_t> data_window{0, 0, 180 * 90 - 1, 89};
  std::uint32_t version = 2;
  std::int32_t lacquer_version = 1;
  bool with_attributes = true;

  /// An empty one-channel table.
  ExrWriter() {
    for (const char* name : {"Y.mean", "Y.variance", "Y.theta_h", "Y.theta_d", "Y.phi_d", "Y.footprint_along", "Y.footprint_across",
                             "Y.footprint_mixed"}) channels[name].type = 2;
    for (const char* name : {"Y.count", "Y.origin"}) channels[name].type = 0;
  }

  void set(const std::string& channel, std::size_t cell, float value) { std::memcpy(&channels.at(channel).bits[cell], &value, 4); }
  void set(const std::string& channel, std::size_t cell, std::uint32_t value) { channels.at(channel).bits[cell] = value; }

  static std::string attribute(const std::string& name, const std::string& type, const std::string& value) {
    return name + '\0' + type + '\0' + raw(static_cast<std::int32_t>(value.size())) + value;
  }

  std::string header() const {
    std::string list;
    for (const auto& [name, c] : channels) list += name + '\0' + raw(c.type) + std::string(4, '\0') + raw(c.sampling) + raw(c.sampling);
    list += '\0';
    std::string window;
    for (const auto v : data_window) window += raw(v);
    std::string h = raw(std::uint32_t{20000630}) + raw(version);
    h += attribute("channels", "chlist", list) + attribute("compression", "compression", std::string(1, '\0'));
    h += attribute("dataWindow", "box2i", window) + attribute("displayWindow", "box2i", window);
    h += attribute("lineOrder", "lineOrder", std::string(1, '\0')) + attribute("pixelAspectRatio", "float", raw(1.0f));
    h += attribute("screenWindowCenter", "v2f", raw(0.0f) + raw(0.0f)) + attribute("screenWindowWidth", "float", raw(1.0f));
    if (with_attributes)
      h += attribute("lacquer.version", "int", raw(lacquer_version)) + attribute("lacquer.absolute_scale", "int", raw(std::int32_t{1})) +
           attribute("lacquer.provenance", "string", "{\"by\": \"hand\"}");
    return h + '\0';
  }

  /// Byte of the file where a value of a cell of the first row (theta_h 0) stands.
  std::size_t position_in_first_row(const std::string& channel, std::size_t cell) const {
    std::size_t position = header().size() + 8 * 90 + 8;
    for (const auto& [name, c] : channels) {
      if (name == channel) return position + (c.type == 1 ? 2 : 4) * cell;
      position += (c.type == 1 ? 2 : 4) * 180 * 90;
    }
    throw std::runtime_error("no channel " + channel);
  }

  std::string content() const {
    constexpr std::size_t width = 180 * 90, height = 90;
    std::string out = header();
    std::size_t line_bytes = 0;
    for (const auto& [name, c] : channels) line_bytes += (c.type == 1 ? 2 : 4) * width;
    for (std::size_t y = 0; y < height; ++y) out += raw(std::uint64_t{out.size() - 8 * y + 8 * height + y * (8 + line_bytes)});
    for (std::size_t y = 0; y < height; ++y) {
      out += raw(static_cast<std::int32_t>(y)) + raw(static_cast<std::int32_t>(line_bytes));
      for (const auto& [name, c] : channels)
        out.append(reinterpret_cast<const char*>(c.bits.data() + y * width), (c.type == 1 ? 2 : 4) * width);
    }
    return out;
  }
};

}  // namespace lacquer::test
