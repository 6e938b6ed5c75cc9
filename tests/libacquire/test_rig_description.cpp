#include <cmath>

#include <glm/geometric.hpp>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "libacquire/rig_description.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "test_support.h"

namespace lacquer::acquire {
namespace {

constexpr double pi = 3.14159265358979323846;

/// A small valid rig file. Tests change one line of it.
const std::string valid = R"([rig]
name = "test"
kind = "simulated"
[camera]
width_px = 640
height_px = 480
layout = "rggb"
bits = 12
focal_length_px = 3000
position_mm = [0, 0, 1000]
[sensor]
sensitivity_e_per_s = 5e5
black_level_dn = 64
[sphere]
radius_mm = 40
[[lights]]
name = "A"
position_mm = [0, 100, 500]
intensity = [1, 2, 3]
diameter_mm = 3
[[lights]]
name = "B"
direction = [0, 3, 4]
on_arm = false
[plan]
angles_deg = { from = 0, to = 180, step = 45 }
exposures_ms = { from = 0.25, to = 4, count = 5 }
)";

std::string replaced(const std::string& from, const std::string& to, std::string text = valid) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

std::string error_of(const std::string& text) {
  try {
    parse_rig(text, "rig.toml");
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::file);
    return e.what();
  }
  return "no error";
}

TEST(RigDescription, UnitsBecomeMetresRadiansSeconds) {
  const RigDescription rig = parse_rig(valid, "rig.toml");
  EXPECT_EQ(rig.name, "test");
  EXPECT_EQ(rig.kind, RigDescription::Kind::simulated);
  EXPECT_EQ(rig.text, valid);
  EXPECT_EQ(rig.sensor.layout, PixelLayout::bayer_rggb);
  EXPECT_EQ(rig.sensor.bits, 12);
  EXPECT_EQ(rig.sensor.sensitivity, glm::dvec3(5e5));
  EXPECT_DOUBLE_EQ(rig.geometry.sphere_radius, 0.04);
  ASSERT_EQ(rig.geometry.lights.size(), 2u);
  const Light& a = rig.geometry.lights[0];
  EXPECT_FALSE(a.distant);
  EXPECT_TRUE(a.on_arm);
  EXPECT_EQ(a.position, glm::dvec3(0, 0.1, 0.5));
  EXPECT_EQ(a.intensity, glm::dvec3(1, 2, 3));
  EXPECT_DOUBLE_EQ(a.diameter, 0.003);
  const Light& b = rig.geometry.lights[1];
  EXPECT_TRUE(b.distant);
  EXPECT_FALSE(b.on_arm);
  EXPECT_NEAR(glm::length(b.direction - glm::dvec3(0, 0.6, 0.8)), 0, 1e-15);
  EXPECT_TRUE(rig.absolute_scale);
}

TEST(RigDescription, PlanIsEveryAngleWithEveryLightAndAGeometricSeries) {
  const RigDescription rig = parse_rig(valid, "rig.toml");
  ASSERT_EQ(rig.plan.size(), 10u);
  EXPECT_DOUBLE_EQ(rig.plan[3].turntable_angle, pi / 4);
  EXPECT_EQ(rig.plan[3].light, 1);
  EXPECT_DOUBLE_EQ(rig.plan[9].turntable_angle, pi);
  ASSERT_EQ(rig.plan[0].exposures_s.size(), 5u);
  for (int i = 0; i < 5; ++i) EXPECT_NEAR(rig.plan[0].exposures_s[i], 0.25e-3 * std::pow(2.0, i), 1e-15);

  const auto listed = parse_rig(
      replaced("{ from = 0, to = 180, step = 45 }", "[10, -20.5]\nlights = [\"B\"]",
               replaced("{ from = 0.25, to = 4, count = 5 }", "[1, 2.5]")), "rig.toml").plan;
  ASSERT_EQ(listed.size(), 2u);
  EXPECT_DOUBLE_EQ(listed[1].turntable_angle, -20.5 * pi / 180);
  EXPECT_EQ(listed[0].light, 1);
  EXPECT_EQ(listed[0].exposures_s, (std::vector<double>{1e-3, 2.5e-3}));
}

TEST(RigDescription, StatedPoseLooksAtTheOrigin) {
  const RigGeometry g = parse_rig(replaced("position_mm = [0, 0, 1000]", "position_mm = [300, 400, 1200]"), "rig.toml").geometry;
  EXPECT_NEAR(glm::length(g.cam_from_rig.translation - glm::dvec3(0, 0, 1.3)), 0, 1e-12) << "3-4-12-13";
  const auto pixel = g.camera.project(g.cam_from_rig * glm::dvec3(0.0));
  EXPECT_NEAR(pixel->x, 319.5, 1e-9) << "the principal point is the middle of the image";
  EXPECT_NEAR(pixel->y, 239.5, 1e-9);
  const auto above = g.camera.project(g.cam_from_rig * glm::dvec3(0, 0.01, 0));
  EXPECT_LT(above->y, pixel->y) << "up is up in the image";
}

TEST(RigDescription, FocalLengthFromMillimetresAndPixelPitch) {
  const auto camera =
      parse_rig(replaced("focal_length_px = 3000", "focal_length_mm = 56\npixel_pitch_um = 6.45"), "rig.toml").geometry.camera;
  EXPECT_NEAR(camera.focal.x, 56 / 6.45e-3, 1e-9);
  EXPECT_EQ(camera.focal.x, camera.focal.y);
}

// The silhouette of the sphere, traced in the finished geometry, must be the circle that was stated.
TEST(RigDescription, CircleInTheImageGivesThePoseOfAPinhole) {
  const auto text = replaced("position_mm = [0, 0, 1000]\n", "", replaced("radius_mm = 40", "radius_mm = 40\ncentre_px = [300, 250]\nradius_px = 70"));
  const RigGeometry g = parse_rig(text, "rig.toml").geometry;
  EXPECT_EQ(g.cam_from_rig.rotation, glm::dmat3({1, 0, 0}, {0, -1, 0}, {0, 0, -1}));
  // Away from the optical axis the outline is an ellipse, longer by half of (tan of its angle)^2 = 3e-5: 0.002 px of 70.
  for (int i = 0; i < 36; ++i) {
    const double a = i * pi / 18;
    const glm::dvec2 direction(std::cos(a), std::sin(a));
    EXPECT_TRUE(trace(g, glm::dvec2(300, 250) + direction * 69.99)) << i;
    EXPECT_FALSE(trace(g, glm::dvec2(300, 250) + direction * 70.01)) << i;
  }
}

TEST(RigDescription, CircleInTheImageGivesTheScaleOfAnOrthographicCamera) {
  const auto text = replaced("focal_length_px = 3000\nposition_mm = [0, 0, 1000]\n", "projection = \"orthographic\"\n",
                             replaced("radius_mm = 40", "centre_px = [300, 250]\nradius_px = 70"));
  const RigGeometry g = parse_rig(text, "rig.toml").geometry;
  EXPECT_DOUBLE_EQ(g.camera.focal.x, 70 / 0.05) << "radius_mm is 50 where it is not stated";
  const auto middle = trace(g, {300, 250});
  ASSERT_TRUE(middle);
  EXPECT_NEAR(glm::length(middle->normal - glm::dvec3(0, 0, 1)), 0, 1e-12);
  const auto up_right = trace(g, {300 + 35, 250 - 35});
  EXPECT_NEAR(glm::length(up_right->normal - glm::dvec3(0.5, 0.5, std::sqrt(0.5))), 0, 1e-12) << "x right, y up";
}

TEST(RigDescription, MaskGivesTheCircleToHundredthsOfAPixel) {
  const test::TemporaryFolder folder;
  cv::Mat mask(480, 640, CV_8UC1, cv::Scalar(0));
  for (int y = 0; y < 480; ++y)
    for (int x = 0; x < 640; ++x)
      if (std::hypot(x - 310.3, y - 222.8) < 70.4) mask.at<unsigned char>(y, x) = 255;
  ASSERT_TRUE(cv::imwrite((folder / "mask.png").string(), mask));
  const std::string text = replaced("position_mm = [0, 0, 1000]\n", "") + "[mask]\nfile = \"mask.png\"\n";
  const RigDescription rig = parse_rig(text, folder / "rig.toml");
  const auto centre = rig.geometry.camera.project(rig.geometry.cam_from_rig.translation);
  EXPECT_NEAR(centre->x, 310.3, 0.05);
  EXPECT_NEAR(centre->y, 222.8, 0.05);
  const double sine = rig.geometry.sphere_radius / glm::length(rig.geometry.cam_from_rig.translation);
  EXPECT_NEAR(3000 * std::tan(std::asin(sine)), 70.4, 0.05);
  ASSERT_EQ(rig.referenced_files.size(), 1u);
  EXPECT_EQ(rig.mask.file, folder / "mask.png");

  mask.rowRange(240, 480).setTo(0);  // half a disc
  ASSERT_TRUE(cv::imwrite((folder / "mask.png").string(), mask));
  EXPECT_THROW(parse_rig(text, folder / "rig.toml"), Error);
}

// Facts of the data set as its README states them: centre (307.9, 263.9), radius 70.9 px, 96 lights.
TEST(RigDescription, DiligentBallIsWhereItsReadmeSays) {
  LACQUER_NEEDS_SHARED_DATA("spheres/diligent-ball");
  const auto rig = read_rig(test::source_dir() / "rigs/diligent-ball.toml", test::shared_data() / "spheres/diligent-ball");
  const auto centre = rig.geometry.camera.project(rig.geometry.cam_from_rig.translation);
  EXPECT_NEAR(centre->x, 307.9, 0.1);
  EXPECT_NEAR(centre->y, 263.9, 0.1);
  const double sine = rig.geometry.sphere_radius / glm::length(rig.geometry.cam_from_rig.translation);
  EXPECT_NEAR(3765.5 * std::tan(std::asin(sine)), 70.9, 0.1);
  ASSERT_EQ(rig.plan.size(), 96u);
  EXPECT_EQ(rig.plan[95].light, 95);
  EXPECT_EQ(rig.plan[95].files.at(0).filename(), "096.png");
  EXPECT_NEAR(rig.geometry.lights[0].direction.y, -0.4317, 1e-4) << "first line of light_directions.txt, y up";
  EXPECT_DOUBLE_EQ(rig.geometry.lights[0].intensity.z, 2.1336);
  EXPECT_FALSE(rig.absolute_scale);
}

TEST(RigDescription, EveryRigFileOfTheRepositoryIsValid) {
  int n = 0;
  for (const auto& entry : std::filesystem::directory_iterator(test::source_dir() / "rigs")) {
    if (entry.path().extension() != ".toml" || entry.path().filename() == "diligent-ball.toml") continue;  // that one needs its data
    SCOPED_TRACE(entry.path());
    const RigDescription rig = read_rig(entry.path());
    if (rig.kind != RigDescription::Kind::simulated) continue;
    EXPECT_TRUE(std::filesystem::exists(rig.simulation.paint)) << rig.simulation.paint;
    // The sphere fills 85 % of the image height.
    const double sine = rig.geometry.sphere_radius / glm::length(rig.geometry.cam_from_rig.translation);
    EXPECT_NEAR(2 * rig.geometry.camera.focal.y * std::tan(std::asin(sine)) / rig.geometry.camera.height, 0.85, 0.01);
    // 12 deg above the camera at angle 0, 600 mm away.
    EXPECT_NEAR(glm::length(rig.geometry.lights[0].position), 0.6, 1e-5);
    EXPECT_NEAR(std::asin(rig.geometry.lights[0].position.y / 0.6), 12 * pi / 180, 1e-5);
    ++n;
  }
  EXPECT_GE(n, 3);
  EXPECT_EQ(read_rig(test::source_dir() / "rigs/simulated-paper.toml").plan.size(), 181u);
}

TEST(RigDescription, TheSmallestFilesOfTheGuideAreValid) {
  const std::string guide = brdf::read_text(test::source_dir() / "rigs/README.md"), begin = "```toml\n";
  std::vector<std::string> files;
  for (std::size_t at = guide.find(begin); at != std::string::npos; at = guide.find(begin, at + 1)) files.push_back(guide.substr(at + begin.size(), guide.find("```", at + begin.size()) - at - begin.size()));
  ASSERT_EQ(files.size(), 3u) << "simulated, photographs, what changes for developed ones";
  const test::TemporaryFolder folder;
  EXPECT_EQ(parse_rig(files[0], folder / "own.toml").plan.size(), 16u);
  for (int i = 1; i <= 488; ++i) test::write_file(folder / ("IMG_" + std::to_string(10000 + i).substr(1) + ".png"), "");
  const RigDescription photographs = parse_rig(files[1], folder / "mine.toml");
  EXPECT_EQ(photographs.plan.size(), 61u);
  EXPECT_FALSE(photographs.absolute_scale);
}

TEST(RigDescription, UnknownKeysNameTheNearestKnownOne) {
  EXPECT_EQ(error_of(replaced("width_px", "widht_px")), "rig.toml: [camera]: unknown key \"widht_px\"; did you mean \"width_px\"?");
  EXPECT_EQ(error_of(replaced("[camera]", "[camra]")), "rig.toml: unknown key \"camra\"; did you mean \"camera\"?");
  EXPECT_EQ(error_of(replaced("direction =", "directoin =")), "rig.toml: lights[1]: unknown key \"directoin\"; did you mean \"direction\"?");
  EXPECT_EQ(error_of(replaced("step = 45", "stepp = 45")), "rig.toml: [plan.angles_deg]: unknown key \"stepp\"; did you mean \"step\"?");
  EXPECT_EQ(error_of(valid + "[simulation]\nblur = 1\n"), "rig.toml: [simulation]: unknown key \"blur\"; did you mean \"blur_px\"?");
}

TEST(RigDescription, ErrorsNameFieldExpectationAndValue) {
  EXPECT_EQ(error_of(replaced("[0, 100, 500]", "[0, 100]")), "rig.toml: lights[0].position_mm: expected 3 numbers, got 2");
  EXPECT_EQ(error_of(replaced("[0, 100, 500]", "[0, \"100\", 500]")),
            "rig.toml: lights[0].position_mm[1]: expected a number from -1e+07 to 1e+07, got a string");
  EXPECT_EQ(error_of(replaced("width_px = 640", "width_px = 640.5")),
            "rig.toml: camera.width_px: expected a whole number from 1 to 32768, got 640.5");
  EXPECT_EQ(error_of(replaced("bits = 12", "bits = 17")), "rig.toml: camera.bits: expected a whole number from 8 to 16, got 17");
  EXPECT_EQ(error_of(replaced("bits = 12", "")), "rig.toml: camera.bits: missing; expected a whole number from 8 to 16");
  EXPECT_EQ(error_of(replaced("5e5", "-1")), "rig.toml: sensor.sensitivity_e_per_s: expected a number above 0 and at most 1e+15, got -1");
  EXPECT_EQ(error_of(replaced("5e5", "nan")), "rig.toml: sensor.sensitivity_e_per_s: expected a number above 0 and at most 1e+15, got nan");
  EXPECT_EQ(error_of(replaced("5e5", "inf")), "rig.toml: sensor.sensitivity_e_per_s: expected a number above 0 and at most 1e+15, got inf");
  EXPECT_EQ(error_of(replaced("black_level_dn = 64", "black_level_dn = 4095")),
            "rig.toml: sensor.black_level_dn: expected a number from 0 to 4094, got 4095");
  EXPECT_EQ(error_of(replaced("\"rggb\"", "\"rgbg\"")),
            "rig.toml: camera.layout: expected \"mono\", \"rgb\", \"rggb\", \"grbg\", \"gbrg\" or \"bggr\", got \"rgbg\"");
  EXPECT_EQ(error_of(replaced("\"A\"", "\"B\"")), "rig.toml: lights[1].name: \"B\" is another light's name already");
  EXPECT_EQ(error_of(replaced("[0, 100, 500]", "[0, 0, 42]")), "no error");
  EXPECT_EQ(error_of(replaced("[0, 100, 500]", "[0, 0, 39]")), "rig.toml: lights[0].position_mm: lies inside the sphere of 40 mm radius");
  EXPECT_EQ(error_of(replaced("[0, 0, 1000]", "[0, 0, 30]")), "rig.toml: camera.position_mm: lies inside the sphere of 40 mm radius");
  EXPECT_EQ(error_of(replaced("[0, 3, 4]", "[0, 0, 0]")), "rig.toml: lights[1].direction: expected a direction, got zero length");
  EXPECT_EQ(error_of(replaced("[0, 0, 1000]", "[0, 0, 1000]\nup = [0, 0, 2]")),
            "rig.toml: camera.up: expected a direction that is not parallel to the line of sight");
  EXPECT_EQ(error_of(replaced("step = 45", "step = 50")),
            "rig.toml: plan.angles_deg.step: expected a step that leads from 0 to 180 in whole steps, got 50");
  EXPECT_EQ(error_of(replaced("{ from = 0.25, to = 4, count = 5 }", "[1, 3, 2]")), "rig.toml: plan.exposures_ms: expected ascending times");
  EXPECT_EQ(error_of(replaced("[plan]", "[plan]\nlights = [\"C\"]")), "rig.toml: plan.lights: no light is named \"C\"; did you mean \"A\"?");
  EXPECT_EQ(error_of(replaced("\"simulated\"", "\"replay\"")),
            "rig.toml: [replay]: missing; a rig of kind \"replay\" names its photographs there");
  EXPECT_EQ(error_of(replaced("position_mm = [0, 0, 1000]\n", "")),
            "rig.toml: camera.position_mm: missing; the camera's place must be known: this, or sphere.centre_px and radius_px, or mask.file");
  EXPECT_EQ(error_of(replaced("[0, 0, 1000]", "[0, 0, 1000]\nlook_at_mm = [900, 0, 0]")),
            "rig.toml: camera: the sphere's centre (the rig's origin) is not in the image; check position_mm, look_at_mm and the image size");
}

TEST(RigDescription, SyntaxErrorsNameTheLineInOneLine) {
  const std::string error = error_of(replaced("bits = 12", "bits = = 12"));
  EXPECT_EQ(error.substr(0, 28), "rig.toml:8: not valid TOML: ") << error;
  EXPECT_EQ(error.find('\n'), std::string::npos);
  const std::string twice = error_of(replaced("bits = 12", "bits = 12\nbits = 12"));
  EXPECT_NE(twice.find("not valid TOML"), std::string::npos) << twice;
  EXPECT_EQ(twice.find('\n'), std::string::npos);
}

TEST(RigDescription, HostileTextIsAnErrorNotACrash) {
  for (const std::string& text : {std::string(100000, '['), "a = " + std::string(100000, '['), "a = " + std::string(100000, '{'),
                                  "a" + std::string(100000, '.') + "b = 1", std::string("a.").append(20000, 'b'), std::string(1000, '\0'),
                                  std::string("\xff\xfe\xff"), std::string("x = \"\\uD800\""), std::string("lights = 3"),
                                  std::string("[rig]\nname = \"a\\u0000b\"\nkind = \"simulated\""), std::string()})
    EXPECT_NE(error_of(text), "no error") << text.substr(0, 40);
  // Every cut of a valid file.
  for (std::size_t n = 0; n < valid.size(); n += 7) error_of(valid.substr(0, n));
}

TEST(RigDescription, CopiedFilesStandInForTheOriginals) {
  const test::TemporaryFolder folder;
  test::write_file(folder / "d.txt", "0 0 1\n0 0.6 0.8\n");
  const std::string text = replaced("kind = \"simulated\"", "kind = \"replay\"", valid.substr(0, valid.find("[[lights]]"))) +
                           "[replay]\nfolder = \"photos\"\nfiles = [\"a.png\", \"b.png\"]\nlight_directions_file = \"../d.txt\"\n";
  const RigDescription rig = parse_rig(text, folder / "rig.toml");
  ASSERT_EQ(rig.referenced_files.size(), 1u);
  EXPECT_EQ(rig.plan[1].files[0], folder / "photos/b.png");

  std::filesystem::create_directories(folder / "elsewhere/rig");
  std::filesystem::rename(folder / "d.txt", folder / "elsewhere/rig/0.txt");
  const std::string copy = with_copied_files(text, {{"../d.txt", "rig/0.txt"}});
  EXPECT_EQ(parse_rig(copy, folder / "elsewhere/rig.toml").geometry.lights.size(), 2u);
  EXPECT_EQ(with_copied_files(copy, {}), text) << "a copy of a copy does not grow";
  EXPECT_THROW(parse_rig(with_copied_files(text, {{"../d.txt", "../secret"}}), folder / "rig.toml"), Error);
  EXPECT_THROW(parse_rig(with_copied_files(text, {{"../d.txt", "/etc/passwd"}}), folder / "rig.toml"), Error);
}

}  // namespace
}  // namespace lacquer::acquire
