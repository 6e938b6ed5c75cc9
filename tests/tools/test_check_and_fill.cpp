#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "libbrdf/files.h"
#include "test_support.h"

namespace lacquer {
namespace {

TEST(CheckCommand, SaysTheAlbedoOfALambertianAndWhatReflectsTooMuch) {
  test::TemporaryFolder folder;
  const std::string file = (folder / "paint.json").string();
  test::write_file(file, R"({"kd": [0.25, 0.5, 1.5], "lobes": []})");
  const auto result = test::run_lacquer("check " + file + " --json --resolution 60");
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto j = nlohmann::json::parse(result.out);
  EXPECT_EQ(j.at("version"), 1);
  EXPECT_EQ(j.at("reciprocity").at("mean_abs_log"), 0);
  for (const auto& r : j.at("reflectance")) {
    EXPECT_NEAR(r.at("value").at(1).get<double>(), 0.5, 5e-3);
    EXPECT_FALSE(r.at("conserves_energy").get<bool>());  // blue
  }
  EXPECT_NE(test::run_lacquer("check " + file + " --resolution 60").out.find("MORE THAN ALL LIGHT"), std::string::npos);
}

TEST(FillCommand, WritesATableWhoseHoleIsFlaggedFilled) {
  test::TemporaryFolder folder;
  brdf::HalfAngleTable table(1);
  auto& t = table.channels[0];
  using Grid = brdf::TableGrid;
  const Grid::Cell hole{20, 20, 40};
  for (int h = 18; h < 23; ++h)
    for (int d = 18; d < 23; ++d)
      for (int p = 35; p < 46; ++p) {
        const std::size_t i = Grid::index(Grid::Cell{h, d, p});
        if (i == Grid::index(hole)) continue;
        t.mean[i] = 0.25f;
        t.origin[i] = brdf::CellOrigin::measured;
      }
  brdf::write_table(folder / "table.exr", table);
  const auto result = test::run_lacquer("fill " + (folder / "table.exr").string() + " -o " + (folder / "filled.exr").string());
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto filled = brdf::read_table(folder / "filled.exr");
  EXPECT_EQ(filled.channels[0].origin[Grid::index(hole)], brdf::CellOrigin::filled);
  EXPECT_NEAR(filled.channels[0].mean[Grid::index(hole)], 0.25, 1e-3);
  EXPECT_EQ(nlohmann::json::parse(filled.provenance_json).at("filling").size(), 1u);
}

TEST(FillCommand, WhatIsNoTableIsAnErrorOfOneLine) {
  test::TemporaryFolder folder;
  test::write_file(folder / "no.exr", "no");
  const auto result = test::run_lacquer("fill " + (folder / "no.exr").string() + " -o " + (folder / "filled.exr").string());
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("no.exr"), std::string::npos);
  EXPECT_FALSE(std::filesystem::exists(folder / "filled.exr"));
}

}  // namespace
}  // namespace lacquer
