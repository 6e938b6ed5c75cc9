#include "libcalib/calibration.h"

#include <gtest/gtest.h>

#include <cmath>

#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "test_support.h"

namespace lacquer::calib {
namespace {

acquire::RigDescription some_rig() {
  acquire::RigDescription rig;
  rig.sensor.bits = 12;
  rig.sensor.layout = acquire::PixelLayout::bayer_rggb;
  rig.sensor.black_level_dn = 64;
  rig.sensor.gain_e_per_dn = 2.5;
  rig.sensor.full_well_e = 9000;
  rig.sensor.sensitivity = {1000, 2000, 1500};
  rig.sensor.vignetting = 0.1;
  rig.geometry.camera.width = 640;
  rig.geometry.camera.height = 480;
  rig.geometry.camera.focal = {1500.25, 1501.75};
  rig.geometry.camera.centre = {319.1, 240.2};
  rig.geometry.camera.distortion = {-0.1, 0.01, 1e-4, -2e-4, 0.003, 0, 0, 0};
  rig.geometry.cam_from_rig = acquire::look_at({0.1, 0.2, 1.0}, {0, 0, 0}, {0, 1, 0});
  acquire::Light near;
  near.name = "A";
  near.position = {0, 0.1, 0.6};
  near.diameter = 0.003;
  acquire::Light distant;
  distant.name = "B";
  distant.distant = true;
  distant.on_arm = false;
  distant.direction = {0, 0.6, 0.8};
  rig.geometry.lights = {near, distant};
  return rig;
}

TEST(Calibration, SaturationLiesSixSigmaBelowTheFullWellWhereItComesBeforeTheAdcLimit) {
  auto rig = some_rig();
  rig.sensor.read_noise_e = 5;
  EXPECT_EQ(calibration_from_rig(rig).noise.saturation_dn, 64 + (9000 - 30) / 2.5);
  rig.sensor.full_well_e = 1e6;
  EXPECT_EQ(calibration_from_rig(rig).noise.saturation_dn, 4095);
}

TEST(Calibration, RoundTripThroughTheFileIsExact) {
  test::TemporaryFolder folder;
  Calibration a = calibration_from_rig(some_rig());
  write_calibration(folder / "c.json", a, "{}");
  const Calibration b = read_calibration(folder / "c.json");
  EXPECT_EQ(b.geometry_source, "rig file");
  EXPECT_EQ(b.geometry.camera.focal, a.geometry.camera.focal);
  EXPECT_EQ(b.geometry.camera.centre, a.geometry.camera.centre);
  EXPECT_EQ(b.geometry.camera.distortion, a.geometry.camera.distortion);
  EXPECT_EQ(b.geometry.cam_from_rig.rotation, a.geometry.cam_from_rig.rotation);
  EXPECT_EQ(b.geometry.cam_from_rig.translation, a.geometry.cam_from_rig.translation);
  ASSERT_EQ(b.geometry.lights.size(), 2u);
  EXPECT_EQ(b.geometry.lights[0].position, a.geometry.lights[0].position);
  EXPECT_EQ(b.geometry.lights[0].diameter, a.geometry.lights[0].diameter);
  EXPECT_TRUE(b.geometry.lights[1].distant);
  EXPECT_FALSE(b.geometry.lights[1].on_arm);
  EXPECT_EQ(b.geometry.lights[1].direction, a.geometry.lights[1].direction);
  EXPECT_EQ(b.dn_per_radiance, a.dn_per_radiance);
  EXPECT_EQ(b.noise.saturation_dn, a.noise.saturation_dn);
  EXPECT_EQ(b.vignetting, a.vignetting);
  ASSERT_EQ(b.response.curves.size(), a.response.curves.size());
  EXPECT_EQ(b.response.curves[2].exposure, a.response.curves[2].exposure);
}

TEST(Calibration, EstimatedCurveSurvivesTheRoundTrip) {
  test::TemporaryFolder folder;
  Calibration a = calibration_from_rig(some_rig());
  a.response.linear = false;
  for (auto& curve : a.response.curves)
    for (std::size_t v = 0; v < curve.exposure.size(); ++v) curve.exposure[v] = std::pow(static_cast<double>(v) / 4095, 2.2) + 1e-6 * static_cast<double>(v);
  write_calibration(folder / "c.json", a, "{}");
  const Calibration b = read_calibration(folder / "c.json");
  EXPECT_FALSE(b.response.linear);
  EXPECT_EQ(b.response.curves[1].exposure, a.response.curves[1].exposure);
}

TEST(Calibration, EveryFieldThatIsMissingOrOfTheWrongTypeIsNamed) {
  test::TemporaryFolder folder;
  write_calibration(folder / "good.json", calibration_from_rig(some_rig()), "{}");
  const std::string good = brdf::read_text(folder / "good.json");
  const auto message_after = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    const auto at = text.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    text.replace(at, from.size(), to);
    test::write_file(folder / "bad.json", text);
    try {
      read_calibration(folder / "bad.json");
    } catch (const Error& e) {
      return std::string(e.what());
    }
    return std::string("accepted");
  };
  EXPECT_NE(message_after("\"sphere_radius\"", "\"sphere_radios\"").find("geometry.sphere_radius: expected a number, but the field is missing"), std::string::npos);
  EXPECT_NE(message_after("\"gain_e_per_dn\": 2.5", "\"gain_e_per_dn\": -1").find("noise.gain_e_per_dn: expected a number in"), std::string::npos);
  EXPECT_NE(message_after("\"version\": 1", "\"version\": 2").find("version: expected 1, got 2"), std::string::npos);
  EXPECT_NE(message_after("\"pinhole\"", "\"fisheye\"").find("geometry.camera.projection: expected"), std::string::npos);
  EXPECT_NE(message_after("\"name\": \"A\"", "\"name\": 3").find("geometry.lights[0].name: expected a text"), std::string::npos);
}

TEST(Calibration, TruncatedFileIsAnErrorThatNamesTheFile) {
  test::TemporaryFolder folder;
  write_calibration(folder / "c.json", calibration_from_rig(some_rig()), "{}");
  const std::string good = brdf::read_text(folder / "c.json");
  for (std::size_t length = 0; length + 2 < good.size(); length += 97) {
    test::write_file(folder / "c.json", good.substr(0, length));
    try {
      read_calibration(folder / "c.json");
      FAIL() << "accepted " << length << " bytes";
    } catch (const Error& e) {
      EXPECT_NE(std::string(e.what()).find("c.json"), std::string::npos);
    }
  }
}

}  // namespace
}  // namespace lacquer::calib
