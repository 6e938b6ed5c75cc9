#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "test_support.h"

namespace lacquer {
namespace {

struct LambertianFiles {
  test::TemporaryFolder folder;
  std::string half = (folder / "half.json").string(), quarter = (folder / "quarter.json").string();

  LambertianFiles() {
    test::write_file(half, R"({"kd": [0.5, 0.5, 0.5], "lobes": []})");
    test::write_file(quarter, R"({"kd": [0.25, 0.25, 0.25], "lobes": []})");
  }
};

TEST(CompareCommand, PrintsTheMetricsOfTwoLambertians) {
  const LambertianFiles files;
  const auto result = test::run_lacquer("compare " + files.half + " " + files.quarter);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.out.find("0.69315"), std::string::npos) << result.out;  // ln 2
  EXPECT_NE(result.out.find(files.half), std::string::npos);
  EXPECT_NE(result.out.find(files.quarter), std::string::npos);
  EXPECT_NE(result.out.find("within 80 deg"), std::string::npos);
  EXPECT_EQ(result.err, "");
}

TEST(CompareCommand, JsonHoldsTheSameNumbersWithVersionAndProvenance) {
  const LambertianFiles files;
  const auto result =
      test::run_lacquer("compare " + files.half + " " + files.quarter + " --json --max-theta-deg 60");
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto j = nlohmann::json::parse(result.out);
  EXPECT_EQ(j.at("version"), 1);
  EXPECT_EQ(j.at("a").at("file"), files.half);
  EXPECT_EQ(j.at("b").at("file"), files.quarter);
  EXPECT_EQ(j.at("inputs").at(files.half).get<std::string>().size(), 32u);
  EXPECT_EQ(j.at("max_theta_deg"), 60);
  EXPECT_NEAR(j.at("metrics").at("mean_abs_log").get<double>(), std::log(2.0), 1e-12);
  EXPECT_NEAR(j.at("metrics").at("bias_log").get<double>(), -std::log(2.0), 1e-12);
  EXPECT_NEAR(j.at("metrics").at("cosine_rms").get<double>(), 0.5, 1e-12);
  EXPECT_GT(j.at("metrics").at("delta_e_2000_mean").get<double>(), 1.0);
}

TEST(CompareCommand, ScaleRemovesTheFactorAndSaysSo) {
  const LambertianFiles files;
  const auto result = test::run_lacquer("compare --scale --json " + files.half + " " + files.quarter);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto metrics = nlohmann::json::parse(result.out).at("metrics");
  EXPECT_NEAR(metrics.at("scale").get<double>(), 2.0, 1e-12);
  EXPECT_NEAR(metrics.at("mean_abs_log").get<double>(), 0.0, 1e-12);
}

TEST(CompareCommand, AFileWithItselfGivesZero) {
  const LambertianFiles files;
  const auto result = test::run_lacquer("compare --json " + files.half + " " + files.half);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto metrics = nlohmann::json::parse(result.out).at("metrics");
  for (const char* name :
       {"mean_abs_log", "rms_log", "max_abs_log", "cosine_rms", "cube_root_rms", "delta_e_2000_mean", "delta_e_2000_p95", "probe_delta_e_2000_mean"})
    EXPECT_EQ(metrics.at(name).get<double>(), 0.0) << name;
}

TEST(CompareCommand, AMissingFileIsOneClearLineAndExitCode1) {
  const LambertianFiles files;
  const auto result =
      test::run_lacquer("compare " + files.half + " " + (files.folder / "none.json").string());
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("none.json"), std::string::npos) << result.err;
  EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
  EXPECT_EQ(result.out, "");
}

TEST(CompareCommand, WrongUsageIsExitCode2) {
  const LambertianFiles files;
  EXPECT_EQ(test::run_lacquer("compare " + files.half).exit_code, 2);
  EXPECT_EQ(test::run_lacquer("compare --max-theta-deg 0 " + files.half + " " + files.quarter).exit_code, 2);
  EXPECT_EQ(test::run_lacquer("compare --max-theta-deg 91 " + files.half + " " + files.quarter).exit_code, 2);
  EXPECT_EQ(test::run_lacquer("compare --max-theta-deg nan " + files.half + " " + files.quarter).exit_code,
            2);
}

}  // namespace
}  // namespace lacquer
