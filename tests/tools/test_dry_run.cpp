#include <gtest/gtest.h>

#include <string>

#include "libacquire/rig_description.h"
#include "libbrdf/files.h"
#include "libcalib/coverage.h"
#include "test_support.h"

namespace lacquer {
namespace {

std::string line_with(const std::string& text, const std::string& beginning) {
  const std::size_t at = text.find(beginning);
  return at == std::string::npos ? "" : text.substr(at, text.find('\n', at) - at);
}

class DryRunTest : public testing::Test {
 protected:
  const std::string rig = (test::source_dir() / "data-samples/tiny-rig.toml").string();
  test::TemporaryFolder folder;
};

// Same geometry, same code: every cell, not just their number. Nothing clips on this rig and its angles are read back as planned.
TEST_F(DryRunTest, CoverageIsThatOfTheRealRunCellByCell) {
  const std::string session = (folder / "session").string();
  const auto dry = test::run_lacquer("-q capture --dry-run " + rig + " -o " + session);
  ASSERT_EQ(dry.exit_code, 0) << dry.err;
  EXPECT_FALSE(std::filesystem::exists(session)) << "nothing is written";
  for (const std::string& command : {"capture " + rig + " -o " + session, "merge " + session, "calibrate geometry --from-rig " + session, "tabulate " + session}) {
    const auto result = test::run_lacquer("-q " + command);
    ASSERT_EQ(result.exit_code, 0) << command << ": " << result.err;
    if (!command.starts_with("tabulate")) continue;
    EXPECT_NE(line_with(result.out, "cells: "), "");
    for (const char* line : {"samples: ", "left out: ", "cells: "}) EXPECT_EQ(line_with(dry.out, line), line_with(result.out, line));
  }
  const brdf::HalfAngleTable table = brdf::read_table(folder / "session/table.exr");
  const auto predicted = calib::predict_coverage(acquire::read_rig(rig), {}, {}).table;
  for (std::size_t c = 0; c < 3; ++c) {
    EXPECT_EQ(predicted.channels[c].origin, table.channels[c].origin);
    EXPECT_EQ(predicted.channels[c].count, table.channels[c].count);
  }
}

TEST_F(DryRunTest, FilesTakeTheSpaceThatWasPredicted) {
  const std::string session = (folder / "session").string();
  const auto dry = test::run_lacquer("-q capture --dry-run " + rig + " -o " + session);
  EXPECT_NE(dry.out.find("disk: 0.4 MB of frames; lacquer measure adds 0.8 MB of radiance"), std::string::npos) << dry.out;
  EXPECT_NE(dry.out.find("are free at " + folder.path().string()), std::string::npos) << "the nearest folder that exists: " << dry.out;
  ASSERT_EQ(test::run_lacquer("-q capture " + rig + " -o " + session).exit_code, 0);
  ASSERT_EQ(test::run_lacquer("-q merge " + session).exit_code, 0);
  const auto size_of = [&](const char* part) {
    double bytes = 0;
    for (const auto& entry : std::filesystem::directory_iterator(std::filesystem::path(session) / part)) bytes += static_cast<double>(entry.file_size());
    return bytes * 1e-6;
  };
  EXPECT_NEAR(size_of("frames"), 0.4, 0.05) << "one digit is printed";
  EXPECT_NEAR(size_of("radiance"), 0.8, 0.05);
}

TEST_F(DryRunTest, MapIsWrittenAsPicture) {
  const auto map = (folder / "map.svg").string();
  const auto dry = test::run_lacquer("-q capture --dry-run " + rig + " --map " + map);
  ASSERT_EQ(dry.exit_code, 0) << dry.err;
  EXPECT_NE(dry.out.find("map: " + map), std::string::npos);
  EXPECT_NE(brdf::read_text(map).find("simulated, tiny"), std::string::npos);
  EXPECT_EQ(test::run_lacquer("-q capture --dry-run " + rig + " --map " + (folder / "map.jpg").string()).exit_code, 2);
}

TEST_F(DryRunTest, MeasureSaysTheSameAndNeedsNoSession) {
  const auto capture = test::run_lacquer("-q capture --dry-run " + rig), measure = test::run_lacquer("-q measure --dry-run " + rig);
  EXPECT_EQ(measure.exit_code, 0);
  EXPECT_EQ(line_with(measure.out, "cells: "), line_with(capture.out, "cells: "));
  EXPECT_NE(line_with(test::run_lacquer("-q measure --dry-run --max-theta-deg 60 " + rig).out, "cells: "), line_with(capture.out, "cells: "));
  EXPECT_EQ(test::run_lacquer("-q capture " + rig).exit_code, 2) << "without --dry-run a folder is needed";
  EXPECT_EQ(test::run_lacquer("-q measure " + rig).exit_code, 2);
}

// A coverage known by hand: cells of theta_h < 2 and theta_d = 7 are measured.
TEST(CoverageMap, CountsReachableAndCoveredCells) {
  brdf::TableChannel channel;
  for (int h = 0; h < 2; ++h)
    for (int p = 0; p < brdf::TableGrid::n_phi_d; ++p) channel.origin[brdf::TableGrid::index(brdf::TableGrid::Cell{h, 7, p})] = p % 2 ? brdf::CellOrigin::measured : brdf::CellOrigin::symmetric;
  channel.origin[brdf::TableGrid::index(brdf::TableGrid::Cell{50, 10, 3})] = brdf::CellOrigin::filled;  // interpolated is not measured
  const calib::CoverageMap map = calib::coverage_map(channel);
  EXPECT_EQ(map.at(0, 7).covered, 180);
  EXPECT_EQ(map.at(1, 7).reachable, 180);
  EXPECT_EQ(map.at(2, 7).covered, 0);
  EXPECT_EQ(map.at(50, 10).covered, 0);
  EXPECT_EQ(map.at(50, 10).reachable, 180);
  EXPECT_EQ(map.at(89, 89).reachable, 0) << "half vector and light both at the horizon: nothing above it";
}

}  // namespace
}  // namespace lacquer
