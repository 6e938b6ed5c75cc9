#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "libbrdf/files.h"
#include "libcalib/calibration.h"
#include "test_support.h"

namespace lacquer {
namespace {

using test::run_lacquer;

/// Lights stated as 1 W/sr without falloff; what they are only the simulation knows.
constexpr const char* rig_text = R"([rig]
name = "scale"
kind = "simulated"
[camera]
width_px = 120
height_px = 90
layout = "rggb"
bits = 12
focal_length_px = 760
position_mm = [0, 0, 1000]
[sensor]
black_level_dn = 64
gain_e_per_dn = 4
read_noise_e = 5
sensitivity_e_per_s = [4e5, 5e5, 4.2e5]
vignetting = 0.1
[[lights]]
position_mm = [0, 125, 587]
[[lights]]
position_mm = [0, 300, 500]
[plan]
angles_deg = [0, 20, 40, 60]
exposures_ms = [2, 6, 18]
[scale]
absolute = false
[simulation]
light_factor = [0.55, 0.58, 0.48]
falloff_exponent = 20
)";

class CalibrateScale : public testing::Test {
 protected:
  CalibrateScale() {
    test::write_file(folder / "rig.toml", rig_text);
    test::write_file(folder / "white.json", R"({"kd": [0.95, 0.96, 0.97], "lobes": []})");
    test::write_file(folder / "paint.json", R"({"kd": [0.3, 0.2, 0.1], "lobes": []})");
    run(fmt::format("capture {0}/rig.toml --paint {0}/white.json --white-reference --every-s 0.1 -o {0}/white", folder.path().string()));
    run(fmt::format("capture {0}/rig.toml --paint {0}/paint.json -o {0}/paint", folder.path().string()));
    for (const char* session : {"white", "paint"}) run(fmt::format("merge {}/{}", folder.path().string(), session));
  }
  std::string run(const std::string& arguments, int code = 0) {
    const auto result = run_lacquer("-q " + arguments);
    EXPECT_EQ(result.exit_code, code) << arguments << "\n" << result.err;
    return result.out + result.err;
  }
  std::string scale(const std::string& more, int code = 0) { return run(fmt::format("calibrate scale {0}/paint --white {0}/white {1}", folder.path().string(), more), code); }
  nlohmann::json fit() {
    run(fmt::format("tabulate {}/paint", folder.path().string()));
    run(fmt::format("fit {0}/paint/table.exr --lobes 0 -o {0}/fit.json", folder.path().string()));
    return nlohmann::json::parse(brdf::read_text(folder / "fit.json"));
  }
  calib::Calibration calibration() { return calib::read_calibration(folder / "paint/calibration.json"); }
  test::TemporaryFolder folder;
};

TEST_F(CalibrateScale, UnknownIntensitiesAndAWhiteSphereGiveTheAbsoluteScaleWithinItsError) {
  const auto relative = fit();
  EXPECT_EQ(relative["scale"], "relative");
  EXPECT_GT(std::abs(std::log(relative["kd"][0].get<double>() / 0.3)), 0.4) << "the stated intensities are wrong by nearly two";

  // The standard's certificate says 0.96 +- 1.5 % in all colours.
  const std::string out = scale("--reflectance 0.96 --sigma 0.015");
  EXPECT_NE(out.find("scale: absolute, 1/sr, known to 1.5"), std::string::npos) << out;
  const calib::Calibration c = calibration();
  EXPECT_TRUE(c.absolute_scale);
  EXPECT_NEAR(c.scale_sigma, 0.015, 0.002);
  EXPECT_NE(c.scale_source.find("white reference, reflectance 0.96"), std::string::npos) << c.scale_source;
  ASSERT_EQ(c.geometry.lights.size(), 2u);
  for (const acquire::Light& light : c.geometry.lights) {
    EXPECT_NEAR(light.falloff_exponent, 20, 1.5);
    // 0.95 and 0.97 against the certificate's 0.96.
    EXPECT_NEAR(light.intensity.r / (0.55 * 0.95 / 0.96), 1, 0.005);
    EXPECT_NEAR(light.intensity.g / 0.58, 1, 0.005);
    EXPECT_NEAR(light.intensity.b / (0.48 * 0.97 / 0.96), 1, 0.005);
  }
  const auto absolute = fit();
  EXPECT_EQ(absolute["scale"], "absolute");
  EXPECT_NEAR(absolute["scale_sigma"].get<double>(), 0.015, 0.002);
  const double truth[] = {0.3, 0.2, 0.1};
  for (int i = 0; i < 3; ++i) EXPECT_LT(std::abs(std::log(absolute["kd"][i].get<double>() / truth[i])), 1.96 * 0.015) << i;
}

TEST_F(CalibrateScale, TheStandardsOwnBrdfLeavesOnlyTheScatter) {
  scale(fmt::format("--reference {}/white.json --sigma 0", folder.path().string()));
  const double sigma = calibration().scale_sigma;
  EXPECT_LT(sigma, 0.004);
  const auto absolute = fit();
  const double truth[] = {0.3, 0.2, 0.1};
  for (int i = 0; i < 3; ++i) EXPECT_LT(std::abs(std::log(absolute["kd"][i].get<double>() / truth[i])), 0.008) << i << ": the error of the fit itself is 0.2 %";
}

TEST_F(CalibrateScale, MistakesAreNamed) {
  EXPECT_NE(scale("", 2).find("expected --reflectance (one number or R G B) or --reference FILE"), std::string::npos);
  EXPECT_NE(scale("--reflectance 0.9 0.9", 2).find("--reflectance: expected 1 or 3 numbers"), std::string::npos);
  EXPECT_NE(scale("--reflectance 0.9 --plate-pixels 100 80 50 50", 2).find("plate: 50 x 50 pixels at (100, 80) are not inside the image"), std::string::npos);
  EXPECT_NE(scale("--reflectance 0.9 --radius-mm 2", 1).find("usable values; expected at least 100"), std::string::npos);
  std::filesystem::remove_all(folder / "white/radiance");
  EXPECT_NE(scale("--reflectance 0.9", 1).find("L000.exr"), std::string::npos);
  EXPECT_FALSE(calibration().absolute_scale) << "untouched";
}

}  // namespace
}  // namespace lacquer
