#include <fmt/format.h>

#include <array>
#include <cstring>
#include <string_view>

#include "libbrdf/brdf.h"
#include "libbrdf/file_error.h"
#include "libbrdf/files.h"
#include "libbrdf/mbsdf.h"
#include "libbrdf/table_files.h"
#include "libbrdf/tensor_file.h"

namespace lacquer::brdf {

namespace {

constexpr std::string_view understood =
    "table.exr of Lacquer, fit.json or {\"kd\", \"lobes\"} JSON, MERL .binary (90 x 90 x 180), RGL .bsdf, "
    "NumPy .npy or CSV of a table, NVIDIA .mbsdf";

bool begins_with(const std::string& head, std::string_view magic) { return head.compare(0, magic.size(), magic) == 0; }

/// First character that is not white space, after a UTF-8 byte order mark.
bool looks_like_json(const std::string& head) {
  const std::size_t start = head.find_first_not_of(" \t\r\n", begins_with(head, "\xef\xbb\xbf") ? 3 : 0);
  return start != std::string::npos && head[start] == '{';
}

/// Three plausible table dimensions and exactly the bytes that three planes of doubles of that size need.
bool looks_like_merl(const std::filesystem::path& file, const std::string& head) {
  std::array<std::int32_t, 3> dims;
  if (head.size() < sizeof(dims)) return false;
  std::memcpy(dims.data(), head.data(), sizeof(dims));
  if (dims == std::array<std::int32_t, 3>{TableGrid::n_theta_h, TableGrid::n_theta_d, TableGrid::n_phi_d}) return true;
  std::uint64_t cells = 1;
  for (const int n : dims) {
    if (n < 1 || n > 10000) return false;
    cells *= static_cast<std::uint64_t>(n);
  }
  std::error_code status;
  return std::filesystem::file_size(file, status) == sizeof(dims) + 3 * sizeof(double) * cells;
}

}  // namespace

std::unique_ptr<Brdf> load_brdf(const std::filesystem::path& file) {
  const auto bytes = read_prefix(file, 4096);
  const std::string head(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (head.empty()) fail_file(file, fmt::format("is empty; expected one of: {}", understood));

  if (begins_with(head, "\x76\x2f\x31\x01")) return std::make_unique<TableBrdf>(read_table(file), "table " + file.string());
  if (begins_with(head, std::string_view(tensor_magic, sizeof(tensor_magic)))) return read_rgl(file);
  if (begins_with(head, npy_magic)) return std::make_unique<TableBrdf>(read_table_npy(file), "NumPy table " + file.string());
  if (begins_with(head, mbsdf_magic)) return read_mbsdf(file);
  if (begins_with(head, csv_magic)) return std::make_unique<TableBrdf>(read_table_csv(file), "CSV table " + file.string());
  if (looks_like_json(head)) return std::make_unique<CookTorranceBrdf>(read_model(file));
  if (looks_like_merl(file, head)) return std::make_unique<TableBrdf>(read_merl(file), "MERL table " + file.string());
  fail_file(file, fmt::format("is not a BRDF file; expected one of: {}", understood));
}

}  // namespace lacquer::brdf
