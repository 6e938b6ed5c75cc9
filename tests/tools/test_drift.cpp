#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "libbrdf/files.h"
#include "libbrdf/table.h"
#include "test_support.h"

namespace lacquer {
namespace {

using test::run_lacquer;

std::string quoted(const std::filesystem::path& p) { return "'" + p.string() + "'"; }

/// The tiny rig with a dim LED that loses 0.9 of its light per hour: exposures a hundred times as long, two minutes in all.
std::string drifting_rig(bool references) {
  std::string text = brdf::read_text(test::source_dir() / "data-samples" / "tiny-rig.toml");
  const auto replace = [&](const std::string& from, const std::string& to) {
    const auto at = text.find(from);
    if (at == std::string::npos) throw std::runtime_error("tiny-rig.toml has no " + from);
    text.replace(at, from.size(), to);
  };
  replace("[4.0e5, 5.0e5, 4.2e5]", "[4.0e3, 5.0e3, 4.2e3]");
  replace("{ from = 0.5, to = 128, count = 3 }", std::string("{ from = 50, to = 12800, count = 3 }") + (references ? "\nreference_every = 2" : ""));
  replace("paints/polaris-silber.json", (test::source_dir() / "data-samples" / "paints" / "polaris-silber.json").string());
  return text + "led_drift_per_hour = 0.9\n";
}

/// Mean of ln(kd / truth) over the channels, and its reported sigma.
std::pair<double, double> measured_kd(const std::filesystem::path& session) {
  const auto fit = nlohmann::json::parse(brdf::read_text(session / "fit.json"));
  const double truth[3] = {0.055, 0.063, 0.071};
  double mean = 0, variance = 0;
  for (const auto& p : fit.at("parameters"))
    for (int c = 0; c < 3; ++c)
      if (p.at("name") == std::string("kd.") + "rgb"[c]) {
        mean += std::log(p.at("value").get<double>() / truth[c]) / 3;
        variance += std::pow(p.at("sigma").get<double>() / truth[c], 2) / 9;
      }
  return {mean, std::sqrt(variance)};
}

TEST(DriftOfTheLight, IsTakenOutByReferenceViewsAndMissedWithoutThem) {
  test::TemporaryFolder folder;
  for (const bool references : {false, true}) {
    const auto rig = folder / (references ? "followed.toml" : "steady.toml"), session = folder / (references ? "followed" : "steady");
    test::write_file(rig, drifting_rig(references));
    const auto result = run_lacquer("measure --no-report " + quoted(rig) + " -o " + quoted(session));
    ASSERT_EQ(result.exit_code, 0) << result.err;
    const auto [bias, sigma] = measured_kd(session);
    if (references) {
      EXPECT_LT(std::abs(bias), 4 * sigma + 0.002) << "0.2 %: the blur of so small a sphere, see test_seeds.cpp";
      EXPECT_NE(result.out.find("by reference views"), std::string::npos) << result.out;
    } else {
      // 3 % are lost over the two minutes of nine views; those taken first see most of the lit sphere and count most.
      EXPECT_LT(bias, -0.004) << "without references the drift must show, or this test shows nothing";
      EXPECT_NE(result.out.find("not followed"), std::string::npos) << result.out;
    }
  }
}

// What measure wrote while it captured is what merge makes of the finished session. (The header of the table names the command.)
TEST(DriftOfTheLight, MergingTheSessionAgainGivesTheSame) {
  test::TemporaryFolder folder;
  test::write_file(folder / "rig.toml", drifting_rig(true));
  const auto session = folder / "s";
  ASSERT_EQ(run_lacquer("measure --no-report " + quoted(folder / "rig.toml") + " -o " + quoted(session)).exit_code, 0);
  const brdf::HalfAngleTable table = brdf::read_table(session / "table.exr");
  const std::string view = brdf::file_checksum(session / "radiance" / "L004.exr");
  for (const std::string stage : {"merge ", "tabulate "}) {
    const auto result = run_lacquer(stage + quoted(session));
    ASSERT_EQ(result.exit_code, 0) << stage << result.err;
  }
  EXPECT_EQ(brdf::file_checksum(session / "radiance" / "L004.exr"), view);
  const brdf::HalfAngleTable again = brdf::read_table(session / "table.exr");
  for (std::size_t c = 0; c < 3; ++c) {
    EXPECT_EQ(again.channels[c].mean, table.channels[c].mean);
    EXPECT_EQ(again.channels[c].variance, table.channels[c].variance);
  }
}

}  // namespace
}  // namespace lacquer
