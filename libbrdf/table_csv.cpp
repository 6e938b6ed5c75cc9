#include <fmt/format.h>

#include <array>
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <numbers>
#include <string_view>

#include "libbrdf/file_error.h"
#include "libbrdf/files.h"
#include "libbrdf/table_files.h"

namespace lacquer::brdf {

namespace {

constexpr double degrees = 180 / std::numbers::pi;
constexpr std::uint64_t max_csv_bytes = std::uint64_t{1} << 30;
constexpr std::array<std::string_view, 5> origin_names{"", "measured", "symmetric", "filled", "modelled"};
constexpr std::string_view coordinates_header = "theta_h_cell,theta_d_cell,phi_d_cell,theta_h_deg,theta_d_deg,phi_d_deg";

std::string header_of(std::size_t n_channels) {
  std::string header(coordinates_header);
  for (std::size_t c = 0; c < n_channels; ++c) {
    const char name = n_channels == 1 ? 'y' : "rgb"[c];
    header += fmt::format(",{0}_mean,{0}_sigma,{0}_count,{0}_origin", name);
  }
  return header;
}

void append_row(fmt::memory_buffer& out, const HalfAngleTable& table, std::size_t i) {
  const auto end = std::back_inserter(out);
  const TableGrid::Cell cell = TableGrid::cell(i);
  const HalfDiff centre = TableGrid::centre(cell);
  fmt::format_to(end, "{},{},{},{:.6g},{:.6g},{:.6g}", cell.theta_h, cell.theta_d, cell.phi_d, centre.theta_h * degrees, centre.theta_d * degrees,
         centre.phi_d * degrees);
  for (const auto& channel : table.channels) {
    if (channel.origin[i] == CellOrigin::empty)
      fmt::format_to(end, ",,,,");
    else
      fmt::format_to(end, ",{},{},{},{}", channel.mean[i], std::sqrt(channel.variance[i]), channel.count[i],
             origin_names[static_cast<std::size_t>(channel.origin[i])]);
  }
  out.push_back('\n');
}

/// The fields of one line, front to back, with the line's number in every complaint.
class Row {
 public:
  Row(const std::filesystem::path& file, std::size_t number, std::string_view text) : file_(file), number_(number), rest_(text) {}

  [[noreturn]] void fail(const std::string& what) const { fail_file(file_, fmt::format("line {}: {}", number_, what)); }

  std::string_view next() {
    if (ended_) fail("has too few fields");
    const auto comma = rest_.find(',');
    const std::string_view field = rest_.substr(0, comma);
    ended_ = comma == std::string_view::npos;
    rest_.remove_prefix(ended_ ? rest_.size() : comma + 1);
    return field;
  }
  bool ended() const { return ended_; }

  template <typename T>
  T number(const char* name, T min, T max) {
    const std::string_view field = next();
    T value{};
    const auto [end, status] = std::from_chars(field.data(), field.data() + field.size(), value);
    if (status != std::errc{} || end != field.data() + field.size() || !(value >= min && value <= max))
      fail(fmt::format("{}: expected a number from {} to {}, got '{}'", name, min, max, printable(std::string(field), 40)));
    return value;
  }

 private:
  const std::filesystem::path& file_;
  std::size_t number_;
  std::string_view rest_;
  bool ended_ = false;
};

void read_channel(Row& row, TableChannel& channel, std::size_t i) {
  constexpr float largest = std::numeric_limits<float>::max();
  Row ahead = row;
  if (ahead.next().empty()) {
    for (int field = 0; field < 4; ++field)
      if (!row.next().empty()) row.fail("expected mean, sigma, count and origin to be all empty or all given");
    return;
  }
  channel.mean[i] = row.number("mean", -largest, largest);
  const float sigma = row.number("sigma", 0.0f, std::sqrt(largest) * 0.999f);
  channel.variance[i] = sigma * sigma;
  channel.count[i] = row.number("count", std::uint32_t{0}, std::numeric_limits<std::uint32_t>::max());
  const std::string_view origin = row.next();
  for (std::size_t k = 1; k < origin_names.size(); ++k)
    if (origin == origin_names[k]) channel.origin[i] = static_cast<CellOrigin>(k);
  if (channel.origin[i] == CellOrigin::empty)
    row.fail(fmt::format("origin: expected measured, symmetric, filled or modelled, got '{}'", printable(std::string(origin), 40)));
  const HalfDiff centre = TableGrid::centre(i);
  channel.theta_h[i] = static_cast<float>(centre.theta_h);
  channel.theta_d[i] = static_cast<float>(centre.theta_d);
  channel.phi_d[i] = static_cast<float>(centre.phi_d);
}

/// Lines front to back; a '\r' at the end belongs to the line's end.
class Lines {
 public:
  explicit Lines(std::string_view text) : rest_(text) {}
  bool next(std::string_view& line) {
    if (rest_.empty()) return false;
    const auto end = rest_.find('\n');
    line = rest_.substr(0, end);
    rest_.remove_prefix(end == std::string_view::npos ? rest_.size() : end + 1);
    if (line.ends_with('\r')) line.remove_suffix(1);
    ++number_;
    return true;
  }
  std::size_t number() const { return number_; }

 private:
  std::string_view rest_;
  std::size_t number_ = 0;
};

/// "# lacquer table, version 1; f_r in 1/sr; scale absolute; scale_sigma 0.01"
void read_magic(const std::filesystem::path& file, std::string_view line, HalfAngleTable& table) {
  if (!line.starts_with(fmt::format("{}, version 1;", csv_magic)))
    fail_file(file, fmt::format("line 1: expected '{}, version 1; ...', got '{}'", csv_magic, printable(std::string(line), 60)));
  const bool absolute = line.find("; scale absolute;") != std::string_view::npos;
  if (!absolute && line.find("; scale relative;") == std::string_view::npos)
    fail_file(file, "line 1: expected 'scale absolute' or 'scale relative'");
  table.absolute_scale = absolute;
  constexpr std::string_view key = "; scale_sigma ";
  const auto at = line.find(key);
  if (at == std::string_view::npos) fail_file(file, "line 1: expected 'scale_sigma'");
  table.scale_sigma = Row(file, 1, line.substr(at + key.size())).number("scale_sigma", 0.0, 10.0);
}

}  // namespace

void write_table_csv(const std::filesystem::path& file, const HalfAngleTable& table) {
  const std::size_t n_channels = table.channels.size();
  if (n_channels != 1 && n_channels != 3)
    throw Error(ErrorCode::input, fmt::format("{}: expected a table of 1 or 3 channels, got {}", file.string(), n_channels));
  std::string provenance = table.provenance_json;
  std::replace_if(provenance.begin(), provenance.end(), [](char c) { return c == '\n' || c == '\r'; }, ' ');
  fmt::memory_buffer out;
  fmt::format_to(std::back_inserter(out), "{}, version 1; f_r in 1/sr, without the cosine; scale {}; scale_sigma {}\n# provenance {}\n{}\n", csv_magic,
                 table.absolute_scale ? "absolute" : "relative", table.scale_sigma, provenance, header_of(n_channels));
  write_atomically(file, [&](const std::filesystem::path& temporary) {
    std::ofstream stream(temporary, std::ios::binary);
    const auto flush = [&] {
      stream.write(out.data(), static_cast<std::streamsize>(out.size()));
      out.clear();
    };
    for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
      bool empty = true;
      for (const auto& channel : table.channels) empty = empty && channel.origin[i] == CellOrigin::empty;
      if (!empty) append_row(out, table, i);
      if (out.size() > (1u << 20)) flush();
    }
    flush();
    stream.close();
    if (!stream) fail_file(file, "cannot be written: the disk may be full or the folder not writable");
  });
}

HalfAngleTable read_table_csv(const std::filesystem::path& file) {
  const std::string text = read_text(file, max_csv_bytes);
  Lines lines(text);
  std::string_view line;
  HalfAngleTable table(0);
  if (!lines.next(line)) fail_file(file, "is empty, expected a table");
  read_magic(file, line, table);
  constexpr std::string_view provenance = "# provenance ";
  while (lines.next(line) && line.starts_with('#'))
    if (line.starts_with(provenance)) table.provenance_json = line.substr(provenance.size());
  for (const std::size_t n : {std::size_t{1}, std::size_t{3}})
    if (line == header_of(n)) table.channels.resize(n);
  if (table.channels.empty())
    fail_file(file, fmt::format("line {}: expected the header '{}', got '{}'", lines.number(), header_of(3), printable(std::string(line), 80)));

  std::vector<bool> seen(TableGrid::n_cells);
  while (lines.next(line)) {
    Row row(file, lines.number(), line);
    TableGrid::Cell cell;
    cell.theta_h = row.number("theta_h_cell", 0, TableGrid::n_theta_h - 1);
    cell.theta_d = row.number("theta_d_cell", 0, TableGrid::n_theta_d - 1);
    cell.phi_d = row.number("phi_d_cell", 0, TableGrid::n_phi_d - 1);
    const std::size_t i = TableGrid::index(cell);
    if (seen[i]) row.fail(fmt::format("cell {},{},{} appears twice", cell.theta_h, cell.theta_d, cell.phi_d));
    seen[i] = true;
    for (int angle = 0; angle < 3; ++angle) row.next();
    for (auto& channel : table.channels) read_channel(row, channel, i);
    if (!row.ended()) row.fail("has too many fields");
  }
  return table;
}

}  // namespace lacquer::brdf
