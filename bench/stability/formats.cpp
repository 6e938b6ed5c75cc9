#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <random>
#include <stdlib.h>

#include "bench/stability/hard_case.h"
#include "bench/stability/tables.h"
#include "libbrdf/error.h"
#include "libbrdf/mbsdf.h"
#include "libbrdf/rgl_writer.h"
#include "libbrdf/table_files.h"
#include "tests/seeded_damage.h"

/// Damaged files of every format, and values that a format cannot hold.
namespace lacquer::bench {

namespace {

namespace fs = std::filesystem;
using namespace brdf;

class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name = (fs::temp_directory_path() / "lacquer-stability-XXXXXX").string();
    if (!mkdtemp(name.data())) throw std::runtime_error("no temporary folder");
    path_ = name;
  }
  ~TemporaryFolder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  fs::path operator/(const std::string& name) const { return path_ / name; }

 private:
  fs::path path_;
};

std::string slurp(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

/// Loads files of `content` damaged in `n` ways, most of them among the first `hot` bytes.
HardCase damage(const std::string& format, const fs::path& file, const std::string& content, int n, std::size_t hot, unsigned seed) {
  std::mt19937 random(seed);
  int refused = 0, other = 0, not_finite = 0, long_text = 0;
  for (int i = 0; i < n; ++i) {
    std::ofstream(file, std::ios::binary) << test::damaged(content, random, hot);
    try {
      const auto brdf = load_brdf(file);
      for (const double theta : {0.0, 0.7, 1.57})
        if (const auto f = brdf->value({direction(0.5, 0), direction(theta, 2)})) not_finite += !(std::isfinite(f->x) && std::isfinite(f->y) && std::isfinite(f->z));
    } catch (const Error& e) {
      ++refused;
      long_text += std::string(e.what()).find('\n') != std::string::npos;
    } catch (const std::exception&) {
      ++other;
    }
  }
  return {format + fmt::format(", {} files with seeded damage", n), "refused in one line, or read to finite values; nothing is allocated that the file does not hold",
          fmt::format("{} refused, {} read, {} else", refused, n - refused - other, other + not_finite + long_text), other + not_finite + long_text == 0};
}

HardCases damaged_files() {
  TemporaryFolder folder;
  const CookTorranceBrdf model(one_lobe(0.1, 0.2, 0.5));
  HalfAngleTable table(1);
  for (std::size_t i = 0; i < TableGrid::n_cells; i += 20011)
    if (TableGrid::reachable(TableGrid::cell(i))) set(table.channels[0], i, 0.1);
  HardCases cases;
  brdf::write_text_atomically(folder / "f.json", model_to_json(model.model()));
  cases.push_back(damage("fit.json", folder / "d.json", slurp(folder / "f.json"), 400, 1000, 1));
  write_table(folder / "t.exr", table);
  cases.push_back(damage("table.exr", folder / "d.exr", slurp(folder / "t.exr"), 12, 1300, 2));
  write_rgl(folder / "r.bsdf", model, {.n_theta_i = 4, .resolution = 8, .ndf_theta = 16, .ndf_phi = 8});
  cases.push_back(damage("RGL .bsdf", folder / "d.bsdf", slurp(folder / "r.bsdf"), 400, 600, 3));
  write_mbsdf(folder / "m.mbsdf", model, {.n_theta = 4, .n_phi = 4});
  cases.push_back(damage("NVIDIA .mbsdf", folder / "d.mbsdf", slurp(folder / "m.mbsdf"), 400, 200, 4));
  write_table_csv(folder / "t.csv", table);
  cases.push_back(damage("CSV", folder / "d.csv", slurp(folder / "t.csv"), 40, 400, 5));
  write_table_npy(folder / "t.npy", table, false);
  cases.push_back(damage("NumPy .npy", folder / "d.npy", slurp(folder / "t.npy").substr(0, 4096), 400, 128, 6));
  std::string merl;
  for (const std::int32_t n : {90, 90, 180}) merl.append(reinterpret_cast<const char*>(&n), 4);
  cases.push_back(damage("MERL .binary, header and length", folder / "d.binary", merl + std::string(4096, '\0'), 400, 12, 7));
  return cases;
}

HardCases values() {
  TemporaryFolder folder;
  HardCases cases;
  const auto refused = [&](const std::string& what, float mean, float variance) {
    HalfAngleTable table(1);
    set(table.channels[0], 500000, 0.1);
    table.channels[0].mean[500000] = mean, table.channels[0].variance[500000] = variance;
    std::string text;
    try {
      write_table(folder / "t.exr", table);
    } catch (const Error& e) {
      text = e.what();
    }
    cases.push_back({what, "the writer refuses what its reader would, no file is left", text.empty() ? "written" : "refused", !text.empty() && !fs::exists(folder / "t.exr")});
  };
  refused("a table with a NaN", std::numeric_limits<float>::quiet_NaN(), 0);
  refused("a table with a negative variance", 0.1f, -1);
  HalfAngleTable table(3);
  std::mt19937_64 random(8);
  for (auto& channel : table.channels)
    for (std::size_t i = 0; i < TableGrid::n_cells; i += 101)
      if (TableGrid::reachable(TableGrid::cell(i))) set(channel, i, std::pow(10.0, -37 + 75 * static_cast<double>(random() >> 11) * 0x1p-53) * (random() % 2 ? 1 : -1), 1e-3);
  write_table(folder / "w.exr", table);
  write_table_csv(folder / "w.csv", table);
  const HalfAngleTable exr = read_table(folder / "w.exr"), csv = read_table_csv(folder / "w.csv");
  std::size_t differ_exr = 0, differ_csv = 0;
  for (std::size_t c = 0; c < 3; ++c) differ_exr += exr.channels[c].mean != table.channels[c].mean, differ_csv += csv.channels[c].mean != table.channels[c].mean;
  cases.push_back({"values of ±1e-37 to ±1e38 through table.exr and through CSV", "the same floats come back", fmt::format("{} and {} channels differ", differ_exr, differ_csv), differ_exr + differ_csv == 0});
  HalfAngleTable negative(1);
  set(negative.channels[0], TableGrid::index(TableGrid::Cell{30, 20, 50}), -1e-3);
  set(negative.channels[0], TableGrid::index(TableGrid::Cell{30, 20, 60}), 1e-3);
  write_merl(folder / "n.binary", negative);
  const HalfAngleTable merl = read_merl(folder / "n.binary");
  const bool empty = merl.channels[0].origin[TableGrid::index(TableGrid::Cell{30, 20, 50})] == CellOrigin::empty;
  cases.push_back({"a negative mean in MERL's format, which marks empty cells so", "becomes an empty cell, as the format cannot tell", empty ? "empty" : "kept", empty});
  CookTorrance odd = one_lobe(1e-300, 0.1 + 1e-16, std::nextafter(1.0, 0.0), glm::dvec3(5e-324, 1.0 / 3, 0.1));
  const CookTorrance back = model_from_json(model_to_json(odd), "round trip");
  const bool same = back.kd == odd.kd && back.lobes[0].ks == odd.lobes[0].ks && back.lobes[0].m == odd.lobes[0].m && back.lobes[0].r == odd.lobes[0].r;
  cases.push_back({"denormal and nearly-one parameters through fit.json", "the fewest digits that read back to the same doubles", same ? "the same" : "they differ", same});
  return cases;
}

}  // namespace

HardCases format_cases() {
  HardCases all = damaged_files();
  for (const HardCase& c : values()) all.push_back(c);
  return all;
}

}  // namespace lacquer::bench
