#include <cmath>

#include "libbrdf/files.h"
#include "tests/libbrdf/file_test_support.h"

namespace lacquer::brdf {
namespace {

using test::expect_file_error;
using test::TemporaryFolder;

constexpr std::size_t n = 1458000;

/// A MERL file by hand: every value -1 but those set.
struct MerlWriter {
  std::vector<std::int32_t> dims{90, 90, 180};
  std::vector<double> values = std::vector<double>(3 * n, -1.0);

  void write(const std::filesystem::path& file) const {
    std::ofstream out(file, std::ios::binary);
    out.write(reinterpret_cast<const char*>(dims.data()), 12);
    out.write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(8 * values.size()));
  }
};

double stored(const std::filesystem::path& file, std::size_t i) {
  std::ifstream in(file, std::ios::binary);
  in.seekg(static_cast<std::streamoff>(12 + 8 * i));
  double value;
  in.read(reinterpret_cast<char*>(&value), 8);
  return value;
}

TEST(Merl, IndexAndScaleAreThoseOfTheDatabasesReader) {
  TemporaryFolder folder;
  MerlWriter merl;
  const std::size_t i = 20 + 180 * 5 + 180 * 90 * 3;  // phi_d 20, theta_d 5, theta_h 3
  for (std::size_t plane = 0; plane < 3; ++plane) merl.values[plane * n + i] = 1500;
  merl.write(folder / "m.binary");
  const HalfAngleTable table = read_merl(folder / "m.binary");
  ASSERT_EQ(table.channels.size(), 3u);
  // red 1.00/1500, green 1.15/1500, blue 1.66/1500
  const float expected[] = {1.0f, 1.15f, 1.66f};
  for (std::size_t c = 0; c < 3; ++c) {
    const auto& channel = table.channels[c];
    EXPECT_FLOAT_EQ(channel.mean[i], expected[c]);
    EXPECT_EQ(channel.count[i], 1u);
    EXPECT_EQ(channel.variance[i], 0.0f);
    EXPECT_EQ(std::count(channel.origin.begin(), channel.origin.end(), CellOrigin::measured), 1);
    // theta_h centre ((3 + 1/2) / 90)^2 90 deg = 0.136111 deg, theta_d 5.5 deg, phi_d 20.5 deg
    EXPECT_NEAR(channel.theta_h[i] * 57.29577951, 0.136111, 1e-6);
    EXPECT_NEAR(channel.theta_d[i] * 57.29577951, 5.5, 1e-5);
    EXPECT_NEAR(channel.phi_d[i] * 57.29577951, 20.5, 1e-5);
  }
}

TEST(Merl, BrdfLooksUpTheCellOfTheDirections) {
  TemporaryFolder folder;
  MerlWriter merl;
  // theta_h 1.2 deg: sqrt(1.2/90) 90 = 10.39 -> 10; theta_d 30.4 -> 30; phi_d -59.5 deg + 180 = 120.5 -> 120
  const std::size_t i = 120 + 180 * 30 + 180 * 90 * 10;
  for (std::size_t plane = 0; plane < 3; ++plane) merl.values[plane * n + i] = 3000;
  merl.write(folder / "m.binary");
  const auto brdf = load_brdf(folder / "m.binary");
  constexpr double degree = 0.017453292519943295;
  const auto f = brdf->value(directions({1.2 * degree, 30.4 * degree, -59.5 * degree}));
  ASSERT_TRUE(f);
  EXPECT_NEAR(f->r, 2.0, 1e-6);
  EXPECT_NEAR(f->b, 3.32, 1e-6);
  EXPECT_FALSE(brdf->value(directions({1.2 * degree, 50 * degree, 0})));
}

TEST(Merl, ACellThatIsNegativeInAnyPlaneIsEmptyAndZeroIsNot) {
  TemporaryFolder folder;
  MerlWriter merl;
  for (std::size_t plane = 0; plane < 3; ++plane) {
    merl.values[plane * n + 100] = plane == 1 ? -1e-30 : 5.0;
    merl.values[plane * n + 101] = plane == 1 ? 0.0 : 5.0;
  }
  merl.write(folder / "m.binary");
  const auto table = read_merl(folder / "m.binary");
  EXPECT_EQ(table.channels[0].origin[100], CellOrigin::empty);
  EXPECT_EQ(table.channels[0].mean[100], 0.0f);
  EXPECT_EQ(table.channels[1].origin[101], CellOrigin::measured);
  EXPECT_EQ(table.channels[1].mean[101], 0.0f);
}

TEST(Merl, RoundTripsEveryFloatAndMarksHolesAndTheUnreachableWithMinusOne) {
  TemporaryFolder folder;
  const CookTorranceBrdf paint({.kd = {0.1, 0.2, 0.3}, .lobes = {{.ks = {0.05, 0.06, 0.07}, .m = 0.1, .r = 0.3}}});
  HalfAngleTable table = tabulate_brdf(paint);
  const std::size_t hole = TableGrid::index(TableGrid::Cell{.theta_h = 2, .theta_d = 3, .phi_d = 4});
  const std::size_t noisy = TableGrid::index(TableGrid::Cell{.theta_h = 2, .theta_d = 3, .phi_d = 5});
  table.channels[1].origin[hole] = CellOrigin::empty;
  table.channels[2].mean[noisy] = -0.01f;  // below the noise: MERL has no way to say so
  // theta_h 80 deg, theta_d 80 deg: one direction is far below the horizon.
  const std::size_t below = TableGrid::index(HalfDiff{1.4, 1.4, 0.1});
  for (auto& channel : table.channels) {
    channel.origin[below] = CellOrigin::filled;
    channel.mean[below] = 1;
  }
  write_merl(folder / "m.binary", table);
  EXPECT_EQ(std::filesystem::file_size(folder / "m.binary"), 34992012u);
  for (const std::size_t i : {hole, noisy, below})
    for (std::size_t plane = 0; plane < 3; ++plane) EXPECT_EQ(stored(folder / "m.binary", plane * n + i), -1.0) << i;

  const HalfAngleTable back = read_merl(folder / "m.binary");
  std::size_t n_different = 0, n_values = 0;
  for (std::size_t c = 0; c < 3; ++c)
    for (std::size_t i = 0; i < n; ++i) {
      const bool special = i == hole || i == noisy || i == below;
      const bool kept = table.channels[c].origin[i] != CellOrigin::empty && !special;
      n_values += kept;
      n_different += kept != (back.channels[c].origin[i] != CellOrigin::empty) || (kept && back.channels[c].mean[i] != table.channels[c].mean[i]);
    }
  EXPECT_EQ(n_different, 0u);
  EXPECT_GT(n_values, 3000000u);
}

TEST(Merl, WritesOneChannelToAllThreePlanes) {
  TemporaryFolder folder;
  HalfAngleTable table(1);
  table.channels[0].origin[200] = CellOrigin::measured;
  table.channels[0].mean[200] = 1.5f;
  write_merl(folder / "m.binary", table);
  EXPECT_DOUBLE_EQ(stored(folder / "m.binary", 200), 2250.0);
  EXPECT_DOUBLE_EQ(stored(folder / "m.binary", n + 200), 1.5 * 1500 / 1.15);
  EXPECT_DOUBLE_EQ(stored(folder / "m.binary", 2 * n + 200), 1.5 * 1500 / 1.66);
  EXPECT_THROW(write_merl(folder / "m.binary", HalfAngleTable(2)), Error);
}

TEST(Merl, NamesSizeDimensionsAndTheBadValue) {
  TemporaryFolder folder;
  const auto file = folder / "m.binary";
  MerlWriter merl;
  merl.values[n + 77] = std::nan("");
  merl.write(file);
  expect_file_error([&] { read_merl(file); }, {"m.binary: green plane, value 77", "nan"});
  merl.values[n + 77] = 1e300;
  merl.write(file);
  expect_file_error([&] { load_brdf(file); }, {"green plane, value 77"});
  merl.dims = {90, 180, 90};
  merl.write(file);
  expect_file_error([&] { load_brdf(file); }, {"dimensions: expected 90 x 90 x 180, got 90 x 180 x 90"});
  merl.dims = {90, 90, 180};
  merl.values.pop_back();
  merl.write(file);
  expect_file_error([&] { load_brdf(file); }, {"34992004 bytes, expected 34992012"});
}

TEST(Merl, ReadsTheMeasuredFilmWithTheStatedNumberOfCells) {
  LACQUER_NEEDS_SHARED_DATA("measured-brdf/vch_golden_yellow.merl.binary");
  const auto table = read_merl(test::shared_data() / "measured-brdf/vch_golden_yellow.merl.binary");
  for (const auto& channel : table.channels)
    EXPECT_EQ(std::count(channel.origin.begin(), channel.origin.end(), CellOrigin::measured), 1096120);
}

}  // namespace
}  // namespace lacquer::brdf
