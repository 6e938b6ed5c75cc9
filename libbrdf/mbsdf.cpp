#include "libbrdf/mbsdf.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <string_view>
#include <vector>

#include "libbrdf/file_error.h"
#include "libbrdf/files.h"

namespace lacquer::brdf {

namespace {

constexpr double pi = std::numbers::pi;
constexpr std::uint64_t max_bytes = std::uint64_t{1} << 30;
constexpr std::uint32_t max_cells = 4096;     // of one axis; files in use have 45 and 90
constexpr std::size_t max_header = 1u << 20;  // text before the data; files in use have some hundred bytes
constexpr std::array<std::string_view, 2> reflection_keys{"MBSDF_DATA_REFLECTION=\n", "MBSDF_DATA=\n"};

/// Cells of a uniform axis: centres at (i + 1/2) / n.
struct CellPair {
  std::size_t first, second;
  double weight;
};
CellPair cells_at(double position, std::size_t n) {
  const double x = std::clamp(position * static_cast<double>(n) - 0.5, 0.0, static_cast<double>(n - 1));
  const auto first = static_cast<std::size_t>(x);
  return {first, std::min(first + 1, n - 1), x - static_cast<double>(first)};
}

class MbsdfBrdf final : public Brdf {
 public:
  struct Grid {
    std::size_t n_theta, n_phi, n_channels;
    std::vector<float> values;  ///< [theta_i][theta_o][phi][channel]
  };
  MbsdfBrdf(Grid grid, std::string description) : grid_(std::move(grid)), description_(std::move(description)) {}
  std::string description() const override { return description_; }

 private:
  std::optional<glm::dvec3> do_value(const Directions& d, const Footprint<double>& /*footprint*/) const override {
    const auto polar = [](const glm::dvec3& w) { return std::atan2(std::hypot(w.x, w.y), w.z); };
    const double azimuth = std::abs(std::atan2(d.wi.x * d.wo.y - d.wi.y * d.wo.x, d.wi.x * d.wo.x + d.wi.y * d.wo.y));
    const CellPair in = cells_at(polar(d.wi) * 2 / pi, grid_.n_theta), out = cells_at(polar(d.wo) * 2 / pi, grid_.n_theta);
    const CellPair phi = cells_at(azimuth / pi, grid_.n_phi);
    glm::dvec3 sum(0.0);
    for (int corner = 0; corner < 8; ++corner) {
      const bool a = corner & 1, b = corner & 2, c = corner & 4;
      const double weight = (a ? in.weight : 1 - in.weight) * (b ? out.weight : 1 - out.weight) * (c ? phi.weight : 1 - phi.weight);
      const std::size_t cell = ((a ? in.second : in.first) * grid_.n_theta + (b ? out.second : out.first)) * grid_.n_phi + (c ? phi.second : phi.first);
      const float* v = grid_.values.data() + cell * grid_.n_channels;
      for (int k = 0; k < 3; ++k) sum[k] += weight * double{v[grid_.n_channels == 3 ? k : 0]};
    }
    return sum;
  }

  Grid grid_;
  std::string description_;
};

/// Where the reflection data begin, after its key.
std::size_t data_begin(const std::filesystem::path& file, std::string_view content) {
  const std::string_view head = content.substr(0, max_header);
  std::size_t begin = std::string_view::npos;
  for (const auto key : reflection_keys) {
    // At the start of a line: the text before may mention a key.
    const auto at = head.find(fmt::format("\n{}", key));
    if (at != std::string_view::npos) begin = std::min(begin, at + 1 + key.size());
  }
  if (begin == std::string_view::npos) fail_file(file, "expected a block MBSDF_DATA_REFLECTION= or MBSDF_DATA=, a measurement of reflection");
  return begin;
}

/// Mean over both directions of the sample at two polar angles and an azimuth; nullopt where the BRDF says nothing.
std::optional<glm::dvec3> value_at(const Brdf& brdf, double theta_i, double theta_o, double phi) {
  const Directions d{direction(theta_i, 0), direction(theta_o, phi)}, mirrored{direction(theta_i, 0), direction(theta_o, -phi)};
  glm::dvec3 sum(0.0);
  int count = 0;
  for (const Directions& each : {d, Directions{d.wo, d.wi}, mirrored, Directions{mirrored.wo, mirrored.wi}})
    if (const auto f = brdf.value(each)) {
      sum += *f;
      ++count;
    }
  if (count == 0) return std::nullopt;
  return sum / static_cast<double>(count);
}

void fill_row(const Brdf& brdf, double theta_i, double theta_o, std::span<float> row) {
  const std::size_t n_phi = row.size() / 3;
  std::vector<bool> known(n_phi);
  for (std::size_t p = 0; p < n_phi; ++p) {
    const auto f = value_at(brdf, theta_i, theta_o, (static_cast<double>(p) + 0.5) / static_cast<double>(n_phi) * pi);
    if (!f) continue;
    known[p] = true;
    for (int c = 0; c < 3; ++c)
      row[3 * p + static_cast<std::size_t>(c)] = static_cast<float>(std::clamp((*f)[c], 0.0, double{std::numeric_limits<float>::max()}));
  }
  for (std::size_t p = 0; p < n_phi; ++p) {
    if (known[p]) continue;
    for (std::size_t step = 1; step < n_phi; ++step) {
      const bool left = p >= step && known[p - step], right = p + step < n_phi && known[p + step];
      if (!left && !right) continue;
      std::copy_n(row.begin() + static_cast<std::ptrdiff_t>(3 * (left ? p - step : p + step)), 3, row.begin() + static_cast<std::ptrdiff_t>(3 * p));
      break;
    }
  }
}

}  // namespace

void MbsdfOptions::validate() const {
  if (n_theta < 2 || n_theta > 360) throw Error(ErrorCode::usage, fmt::format("n_theta: expected 2 to 360, got {}", n_theta));
  if (n_phi < 2 || n_phi > 720) throw Error(ErrorCode::usage, fmt::format("n_phi: expected 2 to 720, got {}", n_phi));
}

std::unique_ptr<Brdf> read_mbsdf(const std::filesystem::path& file) {
  const std::vector<std::byte> bytes = read_bytes(file, max_bytes);
  const std::string_view content(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (!content.starts_with(mbsdf_magic)) fail_file(file, "is not a measured BSDF: expected it to begin with \"NVIDIA ARC MBSDF V1\"");
  const std::size_t begin = data_begin(file, content);
  std::array<std::uint32_t, 3> head;  // type, cells of theta, cells of phi
  if (content.size() - begin < sizeof(head)) fail_file(file, "reflection block is truncated");
  std::memcpy(head.data(), content.data() + begin, sizeof(head));
  const auto [type, n_theta, n_phi] = head;
  if (type > 1) fail_file(file, fmt::format("type: expected 0 (scalar) or 1 (RGB), got {}", type));
  for (const auto& [name, n] : {std::pair{"theta", n_theta}, std::pair{"phi", n_phi}})
    if (n < 1 || n > max_cells) fail_file(file, fmt::format("resolution of {}: expected 1 to {}, got {}", name, max_cells, n));

  MbsdfBrdf::Grid grid{n_theta, n_phi, type == 1 ? std::size_t{3} : std::size_t{1}, {}};
  const std::uint64_t n_values = std::uint64_t{n_theta} * n_theta * n_phi * grid.n_channels;  // at most 3 * 2^36
  const std::size_t data = begin + sizeof(head);
  if (content.size() - data < n_values * sizeof(float))
    fail_file(file, fmt::format("has {} bytes of data, expected {} for {} x {} x {} cells: truncated?", content.size() - data, n_values * sizeof(float),
                                n_theta, n_theta, n_phi));
  grid.values.resize(n_values);
  std::memcpy(grid.values.data(), content.data() + data, n_values * sizeof(float));
  for (std::size_t i = 0; i < grid.values.size(); ++i)
    if (!(std::abs(grid.values[i]) <= std::numeric_limits<float>::max())) fail_file(file, fmt::format("value {}: expected a number, got {}", i, grid.values[i]));
  return std::make_unique<MbsdfBrdf>(std::move(grid), "NVIDIA measured BSDF " + file.string());
}

void write_mbsdf(const std::filesystem::path& file, const Brdf& brdf, const MbsdfOptions& options) {
  options.validate();
  const auto n_theta = static_cast<std::size_t>(options.n_theta), row = 3 * static_cast<std::size_t>(options.n_phi);
  std::vector<float> values(n_theta * n_theta * row);
  const auto theta = [&](std::size_t i) { return (static_cast<double>(i) + 0.5) / static_cast<double>(n_theta) * pi / 2; };
  tbb::parallel_for(std::size_t{0}, n_theta, [&](std::size_t i) {
    for (std::size_t o = 0; o < n_theta; ++o) fill_row(brdf, theta(i), theta(o), std::span(values).subspan((i * n_theta + o) * row, row));
  });
  // Quotation marks and backslashes would need escapes, line breaks end the entry.
  std::string description = printable(options.description, 4000);
  std::replace_if(description.begin(), description.end(), [](char c) { return c == '"' || c == '\\'; }, '\'');
  std::string content = fmt::format("{}description=\"{}\"\nunit=\"1/sr, without the cosine\"\n{}", mbsdf_magic, description, reflection_keys[0]);
  const std::array<std::uint32_t, 3> head{1, static_cast<std::uint32_t>(options.n_theta), static_cast<std::uint32_t>(options.n_phi)};
  content.append(reinterpret_cast<const char*>(head.data()), sizeof(head));
  content.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float));
  write_text_atomically(file, content);
}

}  // namespace lacquer::brdf
