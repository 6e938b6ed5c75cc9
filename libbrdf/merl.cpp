#include <fmt/format.h>

#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>

#include "libbrdf/file_error.h"
#include "libbrdf/files.h"

namespace lacquer::brdf {

namespace {

static_assert(std::endian::native == std::endian::little, "MERL files are little endian");

constexpr std::array<std::int32_t, 3> merl_dims{TableGrid::n_theta_h, TableGrid::n_theta_d, TableGrid::n_phi_d};
/// f_r in 1/sr is the stored value times this; as in the reader that came with the MERL database (Matusik et al. 2003).
constexpr std::array<double, 3> merl_scale{1.00 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0};
constexpr std::size_t merl_bytes = sizeof(merl_dims) + 3 * sizeof(double) * TableGrid::n_cells;
constexpr const char* plane_names[] = {"red", "green", "blue"};

void check_size(const std::filesystem::path& file) {
  std::error_code status;
  const auto size = std::filesystem::file_size(file, status);
  if (!status && size != merl_bytes)
    fail_file(file, fmt::format("has {} bytes, expected {} of a 90 x 90 x 180 MERL table", size, merl_bytes));
}

void set_cell(TableChannel& channel, std::size_t i, float value) {
  const HalfDiff centre = TableGrid::centre(i);
  channel.mean[i] = value;
  channel.count[i] = 1;
  channel.theta_h[i] = static_cast<float>(centre.theta_h);
  channel.theta_d[i] = static_cast<float>(centre.theta_d);
  channel.phi_d[i] = static_cast<float>(centre.phi_d);
  channel.origin[i] = CellOrigin::measured;
}

}  // namespace

HalfAngleTable read_merl(const std::filesystem::path& file) {
  check_size(file);
  const std::vector<std::byte> bytes = read_bytes(file, merl_bytes);
  if (bytes.size() != merl_bytes) fail_file(file, fmt::format("has {} bytes, expected {}", bytes.size(), merl_bytes));
  std::array<std::int32_t, 3> dims;
  std::memcpy(dims.data(), bytes.data(), sizeof(dims));
  if (dims != merl_dims)
    fail_file(file, fmt::format("dimensions: expected 90 x 90 x 180, got {} x {} x {}", dims[0], dims[1], dims[2]));

  HalfAngleTable table(3);
  table.provenance_json = R"({"format": "MERL .binary, value at the cell's centre", "colour_space": "as the file"})";
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
    std::array<double, 3> value;
    bool empty = false;
    for (std::size_t plane = 0; plane < 3; ++plane) {
      const std::size_t at = sizeof(merl_dims) + sizeof(double) * (plane * TableGrid::n_cells + i);
      std::memcpy(&value[plane], bytes.data() + at, sizeof(double));
      value[plane] *= merl_scale[plane];
      if (!(std::abs(value[plane]) <= std::numeric_limits<float>::max()))
        fail_file(file, fmt::format("{} plane, value {}: expected a number that fits in float, got {}", plane_names[plane], i, value[plane]));
      empty = empty || value[plane] < 0;
    }
    if (empty) continue;
    for (std::size_t plane = 0; plane < 3; ++plane) set_cell(table.channels[plane], i, static_cast<float>(value[plane]));
  }
  return table;
}

void write_merl(const std::filesystem::path& file, const HalfAngleTable& table) {
  const std::size_t n_channels = table.channels.size();
  if (n_channels != 1 && n_channels != 3)
    throw Error(ErrorCode::input, fmt::format("{}: a MERL file needs a table of 1 or 3 channels, got {}", file.string(), n_channels));

  std::vector<double> planes(3 * TableGrid::n_cells, -1.0);
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
    bool writable = TableGrid::reachable(TableGrid::cell(i));
    // A negative mean (signal below the noise) cannot be told from "empty" in this format: the whole cell becomes empty.
    for (const auto& channel : table.channels) writable = writable && has_value(channel.origin[i]) && channel.mean[i] >= 0;
    if (!writable) continue;
    for (std::size_t plane = 0; plane < 3; ++plane)
      planes[plane * TableGrid::n_cells + i] = table.channels[n_channels == 3 ? plane : 0].mean[i] / merl_scale[plane];
  }
  write_atomically(file, [&](const std::filesystem::path& temporary) {
    std::ofstream out(temporary, std::ios::binary);
    out.write(reinterpret_cast<const char*>(merl_dims.data()), sizeof(merl_dims));
    out.write(reinterpret_cast<const char*>(planes.data()), static_cast<std::streamsize>(planes.size() * sizeof(double)));
    out.close();
    if (!out) fail_file(file, "cannot be written: the disk may be full or the folder not writable");
  });
}

}  // namespace lacquer::brdf
