#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <string_view>

#include "libbrdf/file_error.h"
#include "libbrdf/files.h"
#include "libbrdf/table_files.h"

namespace lacquer::brdf {

namespace {

static_assert(std::endian::native == std::endian::little, "the arrays are little endian");

constexpr std::size_t magic_size = sizeof(npy_magic) - 1;
constexpr std::uint64_t max_header = 65536;
constexpr std::uint64_t max_npy_bytes = 12 + max_header + 3 * sizeof(double) * TableGrid::n_cells;
constexpr float largest = std::numeric_limits<float>::max();

/// An array of shape (90, 90, 180, C) as floats, channel fastest.
struct Array {
  std::size_t n_channels;
  std::vector<float> values;
};

std::string npy_header(std::size_t n_channels) {
  std::string text = fmt::format("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}, {}, {}, {}), }}", TableGrid::n_theta_h,
                                 TableGrid::n_theta_d, TableGrid::n_phi_d, n_channels);
  // The data begin at a multiple of 64 bytes, after a newline.
  const std::size_t before = magic_size + 2 + 2;
  text.append(63 - (before + text.size()) % 64, ' ');
  text += '\n';
  const auto size = static_cast<std::uint16_t>(text.size());
  std::string header(npy_magic, magic_size);
  header += std::string("\1\0", 2) + std::string(reinterpret_cast<const char*>(&size), sizeof(size)) + text;
  return header;
}

void write_array(const std::filesystem::path& file, const Array& array) {
  std::string content = npy_header(array.n_channels);
  content.append(reinterpret_cast<const char*>(array.values.data()), array.values.size() * sizeof(float));
  write_text_atomically(file, content);
}

/// Text after `key` in a Python dictionary literal such as {'descr': '<f4', 'fortran_order': False, 'shape': (90, 90, 180, 3), }.
std::string_view entry(const std::filesystem::path& file, std::string_view header, std::string_view key) {
  const std::string quoted = fmt::format("'{}':", key);
  const auto at = header.find(quoted);
  if (at == std::string_view::npos) fail_file(file, fmt::format("NumPy header: expected the key '{}'", key));
  std::string_view value = header.substr(at + quoted.size());
  value.remove_prefix(std::min(value.find_first_not_of(' '), value.size()));
  return value;
}

template <typename T>
std::vector<float> values_of(const std::filesystem::path& file, std::span<const std::byte> bytes) {
  std::vector<float> values(bytes.size() / sizeof(T));
  for (std::size_t i = 0; i < values.size(); ++i) {
    T value;
    std::memcpy(&value, bytes.data() + i * sizeof(T), sizeof(T));
    if (std::abs(value) > T{largest})
      fail_file(file, fmt::format("value {}: expected NaN or a number that fits in float, got {}", i, value));
    values[i] = static_cast<float>(value);
  }
  return values;
}

Array read_array(const std::filesystem::path& file) {
  const std::vector<std::byte> bytes = read_bytes(file, max_npy_bytes);
  const auto number = [&](std::size_t at, std::size_t size) {
    if (bytes.size() < at + size) fail_file(file, "NumPy header is truncated");
    std::uint32_t value = 0;
    std::memcpy(&value, bytes.data() + at, size);
    return value;
  };
  if (bytes.size() < magic_size || std::memcmp(bytes.data(), npy_magic, magic_size) != 0) fail_file(file, "is not a NumPy array");
  const std::uint32_t major = number(magic_size, 1);
  if (major < 1 || major > 3) fail_file(file, fmt::format("expected version 1 to 3 of the NumPy format, got {}", major));
  const std::size_t size_of_length = major == 1 ? 2 : 4;
  const std::uint64_t length = number(magic_size + 2, size_of_length);
  const std::size_t begin = magic_size + 2 + size_of_length;
  if (length > max_header || length > bytes.size() - begin) fail_file(file, "NumPy header is truncated");

  const std::string_view header(reinterpret_cast<const char*>(bytes.data()) + begin, length);
  const std::string_view type = entry(file, header, "descr");
  const std::size_t item = type.starts_with("'<f4'") ? 4 : type.starts_with("'<f8'") ? 8 : 0;
  if (item == 0) fail_file(file, fmt::format("descr: expected '<f4' or '<f8', got {}", printable(std::string(type.substr(0, 8)))));
  if (!entry(file, header, "fortran_order").starts_with("False")) fail_file(file, "fortran_order: expected False (numpy.ascontiguousarray)");
  std::string shape(entry(file, header, "shape"));
  shape = shape.substr(0, shape.find(')'));
  std::erase(shape, ' ');
  Array array{shape == "(90,90,180,1" ? std::size_t{1} : shape == "(90,90,180,3" ? std::size_t{3} : std::size_t{0}, {}};
  if (array.n_channels == 0)
    fail_file(file, fmt::format("shape: expected (90, 90, 180, 1) or (90, 90, 180, 3), got {})", printable(shape, 60)));

  const std::span<const std::byte> data = std::span(bytes).subspan(begin + length);
  const std::size_t expected = item * array.n_channels * TableGrid::n_cells;
  if (data.size() != expected) fail_file(file, fmt::format("has {} bytes of data, expected {}", data.size(), expected));
  array.values = item == 4 ? values_of<float>(file, data) : values_of<double>(file, data);
  return array;
}

std::filesystem::path side_file(const std::filesystem::path& file) { return file.string() + ".json"; }

/// Discarded where it is not JSON or so deep that writing it would exhaust the stack.
nlohmann::ordered_json parse_shallow(const std::string& text) {
  constexpr int max_depth = 64;
  int deepest = 0;
  const auto keep = [&](int depth, nlohmann::ordered_json::parse_event_t, const nlohmann::ordered_json&) {
    deepest = std::max(deepest, depth);
    return depth <= max_depth;
  };
  auto json = nlohmann::ordered_json::parse(text, keep, false);
  return deepest > max_depth ? nlohmann::ordered_json(nlohmann::ordered_json::value_t::discarded) : json;
}

/// Scale and provenance of the file beside an array. Anything it does not say stays as it is.
void read_side_file(const std::filesystem::path& file, HalfAngleTable& table) {
  std::error_code missing;
  if (!std::filesystem::is_regular_file(file, missing)) return;
  try {
    const auto json = parse_shallow(read_text(file, 1 << 20));
    if (json.is_discarded()) fail_file(file, "is not valid JSON");
    table.absolute_scale = json.at("scale").get<std::string>() == "absolute";
    table.scale_sigma = json.at("scale_sigma").get<double>();
    table.provenance_json = json.at("provenance").dump();
  } catch (const nlohmann::json::exception& e) {
    fail_file(file, fmt::format("is not the description of a table: {}", e.what()));
  }
  if (!(table.scale_sigma >= 0 && table.scale_sigma < 10)) fail_file(file, "scale_sigma: expected a number from 0 to 10");
}

}  // namespace

std::filesystem::path sigma_file(const std::filesystem::path& npy_file) {
  std::filesystem::path name = npy_file;
  return name.replace_extension(".sigma.npy");
}

void write_side_file(const std::filesystem::path& file, const HalfAngleTable& table, const std::string& format) {
  nlohmann::ordered_json json;
  json["version"] = 1;
  json["format"] = format;
  json["unit"] = "1/sr, without the cosine";
  json["colour_space"] = "as the source: camera RGB of the rig unless the source says that it was converted";
  json["scale"] = table.absolute_scale ? "absolute" : "relative";
  json["scale_sigma"] = table.scale_sigma;
  json["provenance"] = parse_shallow(table.provenance_json);
  if (json["provenance"].is_discarded()) json["provenance"] = table.provenance_json;
  write_text_atomically(side_file(file), json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n");
}

void write_table_npy(const std::filesystem::path& file, const HalfAngleTable& table, bool with_sigma) {
  const std::size_t n_channels = table.channels.size();
  if (n_channels != 1 && n_channels != 3)
    throw Error(ErrorCode::input, fmt::format("{}: expected a table of 1 or 3 channels, got {}", file.string(), n_channels));
  Array mean{n_channels, std::vector<float>(n_channels * TableGrid::n_cells)}, sigma = mean;
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i)
    for (std::size_t c = 0; c < n_channels; ++c) {
      const auto& channel = table.channels[c];
      const bool empty = channel.origin[i] == CellOrigin::empty;
      mean.values[i * n_channels + c] = empty ? std::numeric_limits<float>::quiet_NaN() : channel.mean[i];
      sigma.values[i * n_channels + c] = empty ? std::numeric_limits<float>::quiet_NaN() : std::sqrt(channel.variance[i]);
    }
  write_array(file, mean);
  // A sigma of an earlier array of this name must not be taken for this one's.
  std::error_code missing;
  std::filesystem::remove(sigma_file(file), missing);
  if (with_sigma) write_array(sigma_file(file), sigma);
  write_side_file(file, table, "NumPy array (theta_h, theta_d, phi_d, channel), MERL's grid, f_r at the cell's centre, NaN: empty cell");
}

HalfAngleTable read_table_npy(const std::filesystem::path& file) {
  const Array mean = read_array(file);
  std::optional<Array> sigma;
  std::error_code missing;
  if (std::filesystem::exists(sigma_file(file), missing)) {
    sigma = read_array(sigma_file(file));
    if (sigma->n_channels != mean.n_channels) fail_file(sigma_file(file), fmt::format("expected {} channels, got {}", mean.n_channels, sigma->n_channels));
  }
  HalfAngleTable table(mean.n_channels);
  table.provenance_json = R"({"format": "NumPy array"})";
  read_side_file(side_file(file), table);
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
    const HalfDiff centre = TableGrid::centre(i);
    for (std::size_t c = 0; c < mean.n_channels; ++c) {
      const std::size_t at = i * mean.n_channels + c;
      if (std::isnan(mean.values[at])) continue;
      auto& channel = table.channels[c];
      channel.mean[i] = mean.values[at];
      channel.count[i] = 1;
      channel.origin[i] = CellOrigin::measured;
      channel.theta_h[i] = static_cast<float>(centre.theta_h);
      channel.theta_d[i] = static_cast<float>(centre.theta_d);
      channel.phi_d[i] = static_cast<float>(centre.phi_d);
      if (!sigma) continue;
      channel.variance[i] = sigma->values[at] * sigma->values[at];
      if (!(sigma->values[at] >= 0 && channel.variance[i] <= largest))
        fail_file(sigma_file(file), fmt::format("value {}: expected a standard error >= 0, got {}", at, sigma->values[at]));
    }
  }
  return table;
}

std::optional<glm::dvec3> ReciprocalMean::do_value(const Directions& d, const Footprint<double>& footprint) const {
  const auto there = brdf_.value(d, footprint), back = brdf_.value({d.wo, d.wi}, footprint);
  if (there && back) return 0.5 * (*there + *back);
  return there ? there : back;
}

}  // namespace lacquer::brdf
