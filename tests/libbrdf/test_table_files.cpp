#include <cmath>
#include <cstdlib>
#include <random>

#include "libbrdf/files.h"
#include "libbrdf/table_files.h"
#include "tests/libbrdf/file_test_support.h"

namespace lacquer::brdf {
namespace {

using test::expect_file_error;
using test::TemporaryFolder;

void set(TableChannel& channel, std::size_t i, float mean, float variance, std::uint32_t count, CellOrigin origin) {
  const HalfDiff centre = TableGrid::centre(i);
  channel.mean[i] = mean, channel.variance[i] = variance, channel.count[i] = count, channel.origin[i] = origin;
  channel.theta_h[i] = static_cast<float>(centre.theta_h);
  channel.theta_d[i] = static_cast<float>(centre.theta_d);
  channel.phi_d[i] = static_cast<float>(centre.phi_d);
}

/// Cells with one, two and three channels, tiny, huge and negative values.
HalfAngleTable sparse_table(std::size_t n_channels) {
  HalfAngleTable table(n_channels);
  table.absolute_scale = false;
  table.scale_sigma = 0.0125;
  table.provenance_json = R"({"who": "test, \"quoted\""})";
  std::mt19937 rng(3);
  const CellOrigin origins[] = {CellOrigin::measured, CellOrigin::symmetric, CellOrigin::filled, CellOrigin::modelled};
  for (std::size_t i = 5; i < TableGrid::n_cells; i += 3001)
    for (std::size_t c = 0; c < n_channels; ++c) {
      if (n_channels == 3 && rng() % 3 == 0) continue;
      const float mean = std::ldexp(static_cast<float>(rng()) / 4e9f + 0.1f, static_cast<int>(rng() % 60) - 40);
      const float sigma = 0.01f * mean;
      set(table.channels[c], i, rng() % 7 ? mean : -mean, sigma * sigma, 1 + static_cast<std::uint32_t>(rng() % 100000), origins[rng() % 4]);
    }
  return table;
}

TEST(TableCsv, ReadsBackWhatItHolds) {
  TemporaryFolder folder;
  for (const std::size_t n : {std::size_t{1}, std::size_t{3}}) {
    const HalfAngleTable table = sparse_table(n);
    write_table_csv(folder / "t.csv", table);
    const HalfAngleTable read = read_table_csv(folder / "t.csv");
    ASSERT_EQ(read.channels.size(), n);
    EXPECT_FALSE(read.absolute_scale);
    EXPECT_EQ(read.scale_sigma, 0.0125);
    EXPECT_EQ(read.provenance_json, table.provenance_json);
    for (std::size_t c = 0; c < n; ++c) {
      EXPECT_EQ(read.channels[c].mean, table.channels[c].mean);
      EXPECT_EQ(read.channels[c].count, table.channels[c].count);
      EXPECT_EQ(read.channels[c].origin, table.channels[c].origin);
      EXPECT_EQ(read.channels[c].theta_h, table.channels[c].theta_h);
      for (std::size_t i = 0; i < TableGrid::n_cells; ++i)
        ASSERT_NEAR(read.channels[c].variance[i], table.channels[c].variance[i], 2e-7f * table.channels[c].variance[i]) << i;
    }
    EXPECT_EQ(load_brdf(folder / "t.csv")->description().find("CSV table"), 0u);
  }
}

TEST(TableCsv, IsARowPerCellWithAHeaderThatSpreadsheetsRead) {
  TemporaryFolder folder;
  HalfAngleTable table(3);
  // phi_d 20, theta_d 5, theta_h 3: centres 0.136111, 5.5 and 20.5 degrees
  set(table.channels[1], 20 + 180 * 5 + 180 * 90 * 3, 0.5f, 0.0625f, 7, CellOrigin::symmetric);
  write_table_csv(folder / "t.csv", table);
  EXPECT_EQ(test::slurp(folder / "t.csv"),
            "# lacquer table, version 1; f_r in 1/sr, without the cosine; scale absolute; scale_sigma 0\n"
            "# provenance {}\n"
            "theta_h_cell,theta_d_cell,phi_d_cell,theta_h_deg,theta_d_deg,phi_d_deg,r_mean,r_sigma,r_count,r_origin,g_mean,g_sigma,g_count,"
            "g_origin,b_mean,b_sigma,b_count,b_origin\n"
            "3,5,20,0.136111,5.5,20.5,,,,,0.5,0.25,7,symmetric,,,,\n");
}

std::string one_row(const std::string& row, const std::string& first = "# lacquer table, version 1; f_r in 1/sr; scale relative; scale_sigma 0") {
  return first + "\ntheta_h_cell,theta_d_cell,phi_d_cell,theta_h_deg,theta_d_deg,phi_d_deg,y_mean,y_sigma,y_count,y_origin\n" + row + "\n";
}

TEST(TableCsv, NamesLineAndFieldThatIsWrong) {
  TemporaryFolder folder;
  const auto expect = [&](const std::string& content, const std::vector<std::string>& parts) {
    test::write_file(folder / "t.csv", content);
    expect_file_error([&] { load_brdf(folder / "t.csv"); }, parts);
  };
  test::write_file(folder / "t.csv", one_row("3,5,20,0,0,0,0.5,0.1,7,measured\r"));
  EXPECT_EQ(read_table_csv(folder / "t.csv").channels[0].count[20 + 180 * 5 + 180 * 90 * 3], 7u);
  expect(one_row("90,5,20,0,0,0,0.5,0.1,7,measured"), {"t.csv: line 3: theta_h_cell: expected a number from 0 to 89, got '90'"});
  expect(one_row("3,5,20,0,0,0,nan,0.1,7,measured"), {"line 3: mean", "'nan'"});
  expect(one_row("3,5,20,0,0,0,1e39,0.1,7,measured"), {"line 3: mean"});
  expect(one_row("3,5,20,0,0,0,0.5,-1,7,measured"), {"line 3: sigma", "'-1'"});
  expect(one_row("3,5,20,0,0,0,0.5,0.1,4294967296,measured"), {"line 3: count"});
  expect(one_row("3,5,20,0,0,0,0.5,0.1,7,guessed"), {"origin: expected measured, symmetric, filled or modelled, got 'guessed'"});
  expect(one_row("3,5,20,0,0,0,0.5,0.1,7"), {"line 3: has too few fields"});
  expect(one_row("3,5,20,0,0,0,0.5,0.1,7,measured,1"), {"line 3: has too many fields"});
  expect(one_row("3,5,20,0,0,0,,0.1,7,measured"), {"all empty or all given"});
  expect(one_row("3,5,20,0,0,0,1,0,1,measured\n3,5,20,0,0,0,1,0,1,measured"), {"line 4: cell 3,5,20 appears twice"});
  expect("# lacquer table, version 2; x\n", {"line 1: expected '# lacquer table, version 1;"});
  expect("# lacquer table, version 1; scale absolute; scale_sigma 11\n", {"scale_sigma: expected a number from 0 to 10"});
  expect("# lacquer table, version 1; f; scale absolute; scale_sigma 0\na,b\n", {"line 2: expected the header"});
}

TEST(TableNpy, ReadsBackWhatItHolds) {
  TemporaryFolder folder;
  for (const std::size_t n : {std::size_t{1}, std::size_t{3}}) {
    const HalfAngleTable table = sparse_table(n);
    write_table_npy(folder / "t.npy", table, true);
    const HalfAngleTable read = read_table_npy(folder / "t.npy");
    EXPECT_FALSE(read.absolute_scale);
    EXPECT_EQ(read.scale_sigma, 0.0125);
    EXPECT_NE(read.provenance_json.find("quoted"), std::string::npos);
    ASSERT_EQ(read.channels.size(), n);
    for (std::size_t c = 0; c < n; ++c) {
      EXPECT_EQ(read.channels[c].mean, table.channels[c].mean);
      for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
        ASSERT_NEAR(read.channels[c].variance[i], table.channels[c].variance[i], 2e-7f * table.channels[c].variance[i]) << i;
        ASSERT_EQ(read.channels[c].origin[i] == CellOrigin::empty, table.channels[c].origin[i] == CellOrigin::empty) << i;
      }
    }
  }
  write_table_npy(folder / "t.npy", sparse_table(1), false);
  EXPECT_FALSE(std::filesystem::exists(folder / "t.sigma.npy")) << "a sigma of another table must not stay beside the new one";
}

TEST(TableNpy, NumPyLoadsIt) {
  if (!test::python_has_numpy()) GTEST_SKIP() << "SKIPPED LOUDLY: " << test::python << " has no numpy (Debian: python3-numpy)";
  TemporaryFolder folder;
  HalfAngleTable table(3);
  set(table.channels[2], 20 + 180 * 5 + 180 * 90 * 3, 0.5f, 0.0625f, 7, CellOrigin::measured);
  write_table_npy(folder / "t.npy", table, true);
  test::write_file(folder / "check.py", R"(
import numpy, sys
a, s = numpy.load(sys.argv[1] + "/t.npy"), numpy.load(sys.argv[1] + "/t.sigma.npy")
assert a.shape == s.shape == (90, 90, 180, 3) and a.dtype == s.dtype == numpy.float32
assert a[3, 5, 20, 2] == 0.5 and s[3, 5, 20, 2] == 0.25
assert numpy.isnan(a).sum() == numpy.isnan(s).sum() == a.size - 1
numpy.save(sys.argv[1] + "/double.npy", a.astype(float))
numpy.save(sys.argv[1] + "/fortran.npy", numpy.asfortranarray(a))
)");
  ASSERT_EQ(std::system((test::python + " " + (folder / "check.py").string() + " " + folder.path().string()).c_str()), 0);
  EXPECT_EQ(read_table_npy(folder / "double.npy").channels[2].mean, table.channels[2].mean);
  expect_file_error([&] { read_table_npy(folder / "fortran.npy"); }, {"fortran.npy: fortran_order: expected False"});
}

TEST(TableNpy, DamagedHeadersAndSizesAreErrors) {
  TemporaryFolder folder;
  const std::string header = std::string("\x93NUMPY\x01\x00", 8) + std::string("\x46\x00", 2);
  const auto expect = [&](std::string text, const std::string& part) {
    text.resize(0x46, ' ');
    test::write_file(folder / "t.npy", header + text);
    expect_file_error([&] { load_brdf(folder / "t.npy"); }, {"t.npy", part});
  };
  expect("{'descr': '<i4', 'fortran_order': False, 'shape': (90, 90, 180, 3)}", "descr: expected '<f4' or '<f8'");
  expect("{'descr': '<f4', 'fortran_order': False, 'shape': (90, 90, 180, 2)}", "shape: expected");
  expect("{'descr': '<f4', 'fortran_order': False, 'shape': (90, 90, 180, 3)}", "has 0 bytes of data, expected 17496000");
  expect("{'descr': '<f4'}", "expected the key 'fortran_order'");
  for (std::size_t size = 0; size < 20; ++size) {
    test::write_file(folder / "t.npy", (header + "{'descr': '<f4'").substr(0, size));
    expect_file_error([&] { load_brdf(folder / "t.npy"); }, {"t.npy"});
  }
  HalfAngleTable table(1);
  write_table_npy(folder / "i.npy", table, false);
  std::string content = test::slurp(folder / "i.npy");
  content.replace(content.size() - 8, 4, test::raw(INFINITY));
  test::write_file(folder / "i.npy", content);
  expect_file_error([&] { read_table_npy(folder / "i.npy"); }, {"value 1457998", "inf"});
}

TEST(TableNpy, ADeepOrDamagedSideFileIsAnErrorNotACrash) {
  TemporaryFolder folder;
  write_table_npy(folder / "t.npy", HalfAngleTable(1), false);
  for (const std::string& text : {std::string(500000, '['), std::string("{}"), std::string("x"), std::string(R"({"scale": 1})")}) {
    test::write_file(folder / "t.npy.json", text);
    expect_file_error([&] { read_table_npy(folder / "t.npy"); }, {"t.npy.json"});
  }
  HalfAngleTable hostile(1);
  hostile.provenance_json = "{\"a\":" + std::string(100000, '[') + std::string(100000, ']') + "}";
  write_table_npy(folder / "h.npy", hostile, false);
  EXPECT_NO_THROW(read_table_npy(folder / "h.npy"));
}

TEST(ReciprocalMean, IsTheMeanOfBothDirectionsAndReciprocal) {
  const auto film = load_brdf(test::source_dir() / "data-samples/measured/vch_golden_yellow_rgb.bsdf");
  const ReciprocalMean mean(*film);
  const Directions d{direction(0.4, 0.1), direction(1.0, 2.0)}, back{d.wo, d.wi};
  EXPECT_EQ(mean.value(d)->g, mean.value(back)->g);
  EXPECT_DOUBLE_EQ(mean.value(d)->g, (film->value(d)->g + film->value(back)->g) / 2);
}

}  // namespace
}  // namespace lacquer::brdf
