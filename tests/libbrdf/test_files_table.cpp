#include <cmath>
#include <limits>
#include <random>

#include "libbrdf/files.h"
#include "tests/libbrdf/exr_writer.h"

namespace lacquer::brdf {
namespace {

using test::expect_file_error;
using test::ExrWriter;
using test::TemporaryFolder;

/// Seeded values in some of the cells, all origins, extremes included.
HalfAngleTable random_table(std::size_t n_channels) {
  std::mt19937 rng(7);
  std::uniform_real_distribution<float> uniform(0, 1);
  HalfAngleTable table(n_channels);
  table.absolute_scale = false;
  table.provenance_json = R"({"command": "lacquer tabulate \"x\"", "unit": "1/sr"})";
  for (auto& channel : table.channels)
    for (std::size_t i = 0; i < TableGrid::n_cells; i += 1 + rng() % 50) {
      const HalfDiff centre = TableGrid::centre(i);
      channel.mean[i] = (uniform(rng) - 0.1f) * std::exp(20 * uniform(rng));
      channel.variance[i] = uniform(rng);
      channel.footprint_along[i] = uniform(rng);
      channel.footprint_across[i] = uniform(rng);
      channel.footprint_mixed[i] = uniform(rng) - 0.5f;
      channel.count[i] = static_cast<std::uint32_t>(rng());
      channel.theta_h[i] = static_cast<float>(centre.theta_h);
      channel.theta_d[i] = static_cast<float>(centre.theta_d);
      channel.phi_d[i] = static_cast<float>(centre.phi_d);
      channel.origin[i] = static_cast<CellOrigin>(1 + rng() % 5);
    }
  auto& first = table.channels[0];
  first.origin[0] = CellOrigin::measured;
  first.mean[0] = -std::numeric_limits<float>::max();
  first.variance[0] = std::numeric_limits<float>::denorm_min();
  first.phi_d[0] = static_cast<float>(std::acos(-1.0));  // rounds to a float just above pi
  return table;
}

void expect_same(const HalfAngleTable& a, const HalfAngleTable& b) {
  EXPECT_EQ(a.absolute_scale, b.absolute_scale);
  EXPECT_EQ(a.provenance_json, b.provenance_json);
  ASSERT_EQ(a.channels.size(), b.channels.size());
  for (std::size_t c = 0; c < a.channels.size(); ++c) {
    const auto &x = a.channels[c], &y = b.channels[c];
    EXPECT_TRUE(x.mean == y.mean);
    EXPECT_TRUE(x.variance == y.variance);
    EXPECT_TRUE(x.count == y.count);
    EXPECT_TRUE(x.theta_h == y.theta_h && x.theta_d == y.theta_d && x.phi_d == y.phi_d);
    EXPECT_TRUE(x.footprint_along == y.footprint_along && x.footprint_across == y.footprint_across &&
                x.footprint_mixed == y.footprint_mixed);
    EXPECT_TRUE(x.origin == y.origin);
  }
}

TEST(TableExr, RoundTripsToTheLastBitInThreeChannels) {
  TemporaryFolder folder;
  const auto table = random_table(3);
  write_table(folder / "t.exr", table);
  expect_same(read_table(folder / "t.exr"), table);
}

TEST(TableExr, RoundTripsToTheLastBitInOneChannel) {
  TemporaryFolder folder;
  const auto table = random_table(1);
  write_table(folder / "t.exr", table);
  expect_same(read_table(folder / "t.exr"), table);
}

TEST(TableExr, SparseTableIsSmall) {
  TemporaryFolder folder;
  write_table(folder / "t.exr", HalfAngleTable(1));
  // 47 MB of zeros; deflate's limit is about 1000 : 1.
  EXPECT_LT(std::filesystem::file_size(folder / "t.exr"), 500000u);
}

TEST(TableExr, IsTheSameFileEveryTime) {
  TemporaryFolder folder;
  const auto table = random_table(1);
  write_table(folder / "a.exr", table);
  write_table(folder / "b.exr", table);
  EXPECT_EQ(file_checksum(folder / "a.exr"), file_checksum(folder / "b.exr"));
}

TEST(TableExr, ReadsAFileWrittenByHandWithColumnPhiDPlus180ThetaDAndRowThetaH) {
  TemporaryFolder folder;
  ExrWriter exr;
  const std::size_t i = 7 + 180 * (11 + 90 * 13);  // phi_d 7, theta_d 11, theta_h 13
  exr.set("Y.mean", i, 0.5f);
  exr.set("Y.variance", i, 0.25f);
  exr.set("Y.theta_h", i, 0.1f);
  exr.set("Y.theta_d", i, 0.2f);
  exr.set("Y.phi_d", i, 0.3f);
  exr.set("Y.footprint_along", i, 0.7f);
  exr.set("Y.count", i, 9u);
  exr.set("Y.origin", i, 2u);
  test::write_file(folder / "t.exr", exr.content());
  const HalfAngleTable table = read_table(folder / "t.exr");
  ASSERT_EQ(table.channels.size(), 1u);
  EXPECT_TRUE(table.absolute_scale);
  EXPECT_EQ(table.provenance_json, "{\"by\": \"hand\"}");
  const auto& y = table.channels[0];
  const std::size_t j = TableGrid::index(TableGrid::Cell{.theta_h = 13, .theta_d = 11, .phi_d = 7});
  EXPECT_EQ(y.mean[j], 0.5f);
  EXPECT_EQ(y.variance[j], 0.25f);
  EXPECT_EQ(y.theta_h[j], 0.1f);
  EXPECT_EQ(y.theta_d[j], 0.2f);
  EXPECT_EQ(y.phi_d[j], 0.3f);
  EXPECT_EQ(y.footprint_along[j], 0.7f);
  EXPECT_EQ(y.count[j], 9u);
  EXPECT_EQ(y.origin[j], CellOrigin::symmetric);
  EXPECT_EQ(std::count(y.origin.begin(), y.origin.end(), CellOrigin::empty), static_cast<long>(TableGrid::n_cells) - 1);
}

void expect_exr_error(const ExrWriter& exr, const std::vector<std::string>& parts) {
  TemporaryFolder folder;
  test::write_file(folder / "t.exr", exr.content());
  expect_file_error([&] { read_table(folder / "t.exr"); }, parts);
}

/// One file of a measured cell 180 and an empty cell 5 in which single values are overwritten.
class DamagedTable {
 public:
  DamagedTable() {
    exr_.set("Y.origin", 180, 1u);
    test::write_file(folder_ / "t.exr", exr_.content());
  }
  template <typename T>
  void expect_error(const std::string& channel, std::size_t cell, T value, const std::vector<std::string>& parts) {
    overwrite(channel, cell, test::raw(value));
    expect_file_error([&] { read_table(folder_ / "t.exr"); }, parts);
    overwrite(channel, cell, test::raw(T{0}));
  }

 private:
  void overwrite(const std::string& channel, std::size_t cell, const std::string& bytes) {
    std::fstream out(folder_ / "t.exr", std::ios::binary | std::ios::in | std::ios::out);
    out.seekp(static_cast<std::streamoff>(exr_.position_in_first_row(channel, cell)));
    out << bytes;
  }
  TemporaryFolder folder_;
  ExrWriter exr_;
};

TEST(TableExr, NamesChannelAndCellOfABadValue) {
  const float nan = std::nanf(""), infinity = std::numeric_limits<float>::infinity();
  DamagedTable table;
  table.expect_error("Y.mean", 180, nan, {"t.exr: Y.mean: cell (theta_h 0, theta_d 1, phi_d 0): expected a finite number, got nan"});
  table.expect_error("Y.mean", 180, -infinity, {"Y.mean", "finite", "inf"});
  table.expect_error("Y.variance", 180, -1e-9f, {"Y.variance", ">= 0"});
  table.expect_error("Y.variance", 180, infinity, {"Y.variance"});
  table.expect_error("Y.footprint_along", 180, -0.1f, {"Y.footprint_along", ">= 0"});
  table.expect_error("Y.theta_h", 180, 1.6f, {"Y.theta_h", "[0, pi/2]", "1.6"});
  table.expect_error("Y.theta_d", 180, -0.1f, {"Y.theta_d"});
  table.expect_error("Y.phi_d", 180, 3.2f, {"Y.phi_d", "[0, pi]"});
}

TEST(TableExr, RefusesUnknownOriginsAndValuesInEmptyCells) {
  DamagedTable table;
  table.expect_error("Y.origin", 5, 5u, {"Y.origin", "phi_d 5", "0 to 4, got 5"});  // version 1 had no clipped cells
  table.expect_error("Y.mean", 5, 1.0f, {"Y.mean", "empty cell"});
  table.expect_error("Y.count", 5, 1u, {"Y.count", "empty cell"});
}

TEST(TableExr, NamesAChannelThatIsMissingOrOfAnotherType) {
  ExrWriter missing;
  missing.channels.erase("Y.variance");
  expect_exr_error(missing, {"channel Y.variance is missing"});
  ExrWriter half;
  half.channels["Y.theta_d"].type = 1;
  expect_exr_error(half, {"channel Y.theta_d", "32-bit float"});
  ExrWriter real;
  real.channels["Y.count"].type = 2;
  expect_exr_error(real, {"channel Y.count", "32-bit uint"});
  ExrWriter many;
  for (int i = 0; i < 30; ++i) many.channels[std::string("Z").append(std::to_string(i))].type = 2;
  expect_exr_error(many, {"channels: expected at most 30"});
}

TEST(TableExr, RefusesOtherSizesAndOtherFilesWithoutReadingThem) {
  for (const std::vector<std::int32_t>& window :
       {std::vector<std::int32_t>{0, 0, 16198, 89}, {0, 0, 16199, 90}, {1, 0, 16200, 89}, {0, 0, 2147483646, 2147483646}, {-2147483647, 0, 2147483646, 89}}) {
    ExrWriter exr;
    exr.data_window = window;
    TemporaryFolder folder;
    test::write_file(folder / "t.exr", exr.header());
    expect_file_error([&] { read_table(folder / "t.exr"); }, {"dataWindow: expected (0, 0) to (16199, 89)"});
  }
  ExrWriter tiled;
  tiled.version = 2 | 0x200;
  expect_exr_error(tiled, {"scan-line"});
  ExrWriter plain;
  plain.with_attributes = false;
  expect_exr_error(plain, {"lacquer.version is missing"});
  ExrWriter future;
  future.lacquer_version = 3;
  expect_exr_error(future, {"lacquer.version: expected at most 2, got 3"});
}

TEST(TableExr, Version2KnowsClippedCells) {
  TemporaryFolder folder;
  ExrWriter exr;
  exr.lacquer_version = 2;
  exr.set("Y.mean", 42, 0.5f);
  exr.set("Y.origin", 42, 5u);
  test::write_file(folder / "t.exr", exr.content());
  EXPECT_EQ(read_table(folder / "t.exr").channels[0].origin[42], CellOrigin::clipped);
  exr.set("Y.origin", 42, 6u);
  expect_exr_error(exr, {"Y.origin", "0 to 5, got 6"});
}

TEST(TableExr, WriterRefusesWhatTheReaderWould) {
  TemporaryFolder folder;
  HalfAngleTable table(1);
  table.channels[0].origin[3] = CellOrigin::measured;
  table.channels[0].mean[3] = std::nanf("");
  EXPECT_THROW(write_table(folder / "t.exr", table), Error);
  EXPECT_THROW(write_table(folder / "t.exr", HalfAngleTable(2)), Error);
  EXPECT_FALSE(std::filesystem::exists(folder / "t.exr"));
  expect_file_error([&] { write_table(folder / "none" / "t.exr", HalfAngleTable(1)); }, {"none/t.exr", "no folder"});
}

}  // namespace
}  // namespace lacquer::brdf
