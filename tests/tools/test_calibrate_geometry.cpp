#include <cmath>
#include <nlohmann/json.hpp>
#include <regex>

#include "libbrdf/files.h"
#include "libcalib/calibration.h"
#include "test_support.h"

namespace {

using lacquer::test::run_lacquer;
using lacquer::test::TemporaryFolder;

/// The quick rig with fewer views; the sphere millimetres from where the rig file has it, the axis tilted by a degree.
std::string rig_text(const std::string& angles, const std::string& simulation) {
  const std::string quick = lacquer::brdf::read_text(lacquer::test::source_dir() / "rigs/simulated-quick.toml");
  std::string text = quick.substr(0, quick.find("[plan]"));
  text += "[plan]\nangles_deg = " + angles + "\nexposures_ms = { from = 1, to = 64, count = 3 }\n";
  text += "[simulation]\nseed = 3\nblur_px = 0.6\n" + simulation;
  return text;
}

std::string paint(const std::string& name) {
  return "paint = \"" + (lacquer::test::source_dir() / "data-samples/paints" / name).string() + "\"\n";
}

const std::string misplaced = "sphere_offset_mm = [2, -2, 3]\naxis_tilt_x_deg = 1\naxis_tilt_z_deg = -0.8\naxis_offset_mm = [2, 0, -2]\n";

/// Captures and merges; the session's folder.
std::string session_of(const TemporaryFolder& folder, const std::string& rig) {
  lacquer::test::write_file(folder / "rig.toml", rig);
  const std::string session = (folder / "s").string();
  EXPECT_EQ(run_lacquer("-q capture " + (folder / "rig.toml").string() + " -o " + session).exit_code, 0);
  EXPECT_EQ(run_lacquer("-q merge " + session).exit_code, 0);
  return session;
}

/// Number after `name` on the line that begins with "  estimate".
double estimate_error(const std::string& out, const std::string& name) {
  std::smatch match;
  if (!std::regex_search(out, match, std::regex("  estimate .*" + name + " +([0-9.]+)"))) return NAN;
  return std::stod(match[1]);
}

TEST(CalibrateGeometry, AMisplacedSphereAndATiltedAxisAreFound) {
  const TemporaryFolder folder;
  const std::string session = session_of(folder, rig_text("{ from = 0, to = 130, step = 10 }", paint("polaris-silber.json") + misplaced));
  const auto result = run_lacquer("-q calibrate geometry " + session);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  // At the rig file's geometry: 4.8 deg, 0.96 deg and 8.7 px.
  EXPECT_LT(estimate_error(result.out, "half vector"), 0.05) << result.out;
  EXPECT_LT(estimate_error(result.out, "light"), 0.05) << result.out;
  EXPECT_LT(estimate_error(result.out, "sphere centre"), 0.1) << result.out;
  const auto calibration = lacquer::calib::read_calibration(session + "/calibration.json");
  EXPECT_EQ(calibration.geometry_source, "estimated from highlights, silhouette and light on the paint");
  const auto& u = calibration.geometry_uncertainty;
  ASSERT_EQ(u.covariance.size(), u.parameters.size() * u.parameters.size());
  const double truth[] = {0.002, -0.002, 0.003};
  for (std::size_t k = 0; k < 3; ++k) {
    EXPECT_LT(std::abs(u.parameters[k].correction - truth[k]), 4 * u.parameters[k].sigma) << u.parameters[k].name;
    EXPECT_NEAR(std::sqrt(u.covariance[k * u.parameters.size() + k]), u.parameters[k].sigma, 1e-12);
  }
  // Printed with the digits that the error bar leaves: two of the error, and the value to the same place.
  std::smatch row;
  ASSERT_TRUE(std::regex_search(result.out, row, std::regex("\nsphere\\.x +mm +0 +([0-9]+)\\.([0-9]+) ± 0\\.0*([1-9][0-9]) ")));
  EXPECT_NEAR(std::stod(row[1].str() + "." + row[2].str()), 1e3 * u.parameters[0].correction, 0.51 * std::pow(10, -static_cast<double>(row[2].length()))) << result.out;
  EXPECT_NEAR(std::stod(row[3]), 1e3 * u.parameters[0].sigma * std::pow(10, static_cast<double>(row[2].length())), 0.51) << result.out;
  // The rig file's comes back on request.
  ASSERT_EQ(run_lacquer("-q calibrate geometry --from-rig " + session).exit_code, 0);
  const auto back = lacquer::calib::read_calibration(session + "/calibration.json");
  EXPECT_EQ(back.geometry_source, "rig file");
  EXPECT_TRUE(back.geometry_uncertainty.parameters.empty());
}

TEST(CalibrateGeometry, AMattePaintHasOnlyItsShadingAndWithoutThatIsRefusedWithWhatToDo) {
  const TemporaryFolder folder;
  lacquer::test::write_file(folder / "matte.json", R"({"name": "matte", "kd": [0.2, 0.2, 0.2], "lobes": [{"ks": [0.05, 0.05, 0.05], "m": 0.4, "r": 0.1}]})");
  const std::string session = session_of(folder, rig_text("{ from = 0, to = 60, step = 20 }", "paint = \"" + (folder / "matte.json").string() + "\"\n"));
  const auto shaded = run_lacquer("-q calibrate geometry " + session);
  ASSERT_EQ(shaded.exit_code, 0) << shaded.err;
  EXPECT_NE(shaded.out.find("estimated from silhouette and light on the paint"), std::string::npos) << shaded.out;
  EXPECT_LT(estimate_error(shaded.out, "light"), 0.3) << shaded.out;
  const auto result = run_lacquer("-q calibrate geometry --without-paint " + session);
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("no highlight in any of 4 views"), std::string::npos) << result.err;
  EXPECT_NE(result.err.find("--from-rig"), std::string::npos);
  EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
}

TEST(CalibrateGeometry, TooFewAnglesAreSaid) {
  const TemporaryFolder folder;
  const std::string session = session_of(folder, rig_text("[20, 30]", paint("polaris-silber.json")));
  const auto result = run_lacquer("-q calibrate geometry " + session);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.out.find("warning: light 1: 2 highlights over 10 deg of the turntable: too few"), std::string::npos) << result.out;
}

TEST(CalibrateGeometry, ASessionThatIsNotMergedIsRefusedByFile) {
  const TemporaryFolder folder;
  lacquer::test::write_file(folder / "rig.toml", rig_text("[20, 30]", paint("polaris-silber.json")));
  ASSERT_EQ(run_lacquer("-q capture " + (folder / "rig.toml").string() + " -o " + (folder / "s").string()).exit_code, 0);
  const auto result = run_lacquer("-q calibrate geometry " + (folder / "s").string());
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("L000.exr"), std::string::npos) << result.err;
}

TEST(CalibrateGeometry, DirectionsFromTheBallsHighlightsAreThePublishedOnes) {
  LACQUER_NEEDS_SHARED_DATA("spheres/diligent-ball");
  const TemporaryFolder folder;
  const std::string session = (folder / "s").string();
  ASSERT_EQ(run_lacquer("-q capture " + (lacquer::test::source_dir() / "rigs/diligent-ball.toml").string() + " --data " +
                        (lacquer::test::shared_data() / "spheres/diligent-ball").string() + " -o " + session).exit_code, 0);
  ASSERT_EQ(run_lacquer("-q merge " + session).exit_code, 0);
  const auto result = run_lacquer("-q calibrate geometry " + session);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  std::smatch directions;
  ASSERT_TRUE(std::regex_search(result.out, directions, std::regex("rig file's: ([0-9.]+) deg median")));
  EXPECT_LT(std::stod(directions[1]), 0.65) << result.out;
}

}  // namespace
