#include <fmt/format.h>

#include <cmath>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "libacquire/frame.h"
#include "libacquire/lens_residuals.h"
#include "libacquire/rig_description.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libcalib/simulated_boards.h"
#include "test_support.h"

namespace lacquer {
namespace {

using test::run_lacquer;

/// Photograph of a board: 3 x 3 points per pixel, white border of one square, grey noise.
acquire::RawFrame photograph(const test::SimulatedBoards& boards, const glm::dmat3& rotation, const glm::dvec3& middle, unsigned seed, acquire::PixelLayout layout) {
  acquire::RawFrame frame;
  frame.width = boards.camera.width, frame.height = boards.camera.height;
  frame.bits = 12;
  frame.layout = layout;
  std::mt19937_64 random(seed);
  std::normal_distribution<double> noise(0, 12);
  const glm::dvec3 normal = rotation[2];
  const double half_x = 0.5 * (boards.board.columns + 1), half_y = 0.5 * (boards.board.rows + 1);  // squares
  for (int y = 0; y < frame.height; ++y)
    for (int x = 0; x < frame.width; ++x) {
      double sum = 0;
      for (int k = 0; k < 9; ++k) {
        const auto ray = boards.camera.unproject(glm::dvec2(x + (k % 3 - 1) / 3.0, y + (k / 3 - 1) / 3.0));
        const glm::dvec3 p = ray->direction * (glm::dot(normal, middle) / glm::dot(normal, ray->direction)) - middle;
        const double u = glm::dot(p, rotation[0]) / boards.board.square_m + half_x, v = glm::dot(p, rotation[1]) / boards.board.square_m + half_y;
        const bool on_board = u > 0 && v > 0 && u < 2 * half_x && v < 2 * half_y, in_border = u > -1 && v > -1 && u < 2 * half_x + 1 && v < 2 * half_y + 1;
        const bool dark = on_board ? (static_cast<int>(std::floor(u)) + static_cast<int>(std::floor(v))) % 2 == 0 : !in_border;
        sum += dark ? 300 : 3000;
      }
      frame.data.push_back(static_cast<std::uint16_t>(std::clamp(sum / 9 + noise(random), 0.0, 4095.0)));
    }
  return frame;
}

class CalibrateCamera : public testing::Test {
 protected:
  CalibrateCamera() {
    boards.camera = test::usual_camera();
    boards.camera.width = 480, boards.camera.height = 360;
    boards.camera.focal = {437, 438};
    boards.camera.centre = {243, 177};
    boards.board = {7, 5, 0.03};
  }
  /// `n` photographs b0.tiff ...; a rig's mosaic of a grey scene is that scene.
  void photographs(int n, bool tilted = true, acquire::PixelLayout layout = acquire::PixelLayout::mono) {
    for (int i = 0; i < n; ++i) {
      const double a = 2.4 * i, tilt = tilted ? 0.35 + 0.04 * (i % 5) : 0;
      const glm::dmat3 rotation = test::SimulatedBoards::turned({std::cos(a), std::sin(a), 0}, tilt);
      const glm::dvec3 middle(0.09 * ((i % 3) - 1), 0.07 * (((i / 3) % 3) - 1), 0.45 + 0.02 * (i % 4));
      acquire::write_frame((folder / fmt::format("b{}.tiff", i)).string(), photograph(boards, rotation, middle, static_cast<unsigned>(i), layout));
    }
  }
  test::CommandResult calibrate(const std::string& more, const std::string& size = "7x5") {
    return run_lacquer(fmt::format("-q calibrate camera --boards '{}/b*.tiff' --board-size {} --square-mm 30 -o {} {}", folder.path().string(), size, (folder / "lens.cameramodel").string(), more));
  }
  test::SimulatedBoards boards;
  test::TemporaryFolder folder;
};

TEST_F(CalibrateCamera, PhotographsOfABoardGiveTheLensThatARigFileUses) {
  photographs(10);
  const auto result = calibrate("--model opencv4");
  ASSERT_EQ(result.exit_code, 0) << result.err;
  for (const char* text : {"boards: 10 of 10 photographs, 350 corners", "lens: LENSMODEL_OPENCV4, 480 x 360 px, rms ", "corner noise: ", "uncertainty of a pixel, px", "far away  ", "halves of 5 and 5 boards"})
    EXPECT_NE(result.out.find(text), std::string::npos) << text << "\n" << result.out;

  const acquire::Lens lens = acquire::read_lens(folder / "lens.cameramodel");
  const double truth[] = {437, 438, 243, 177};
  for (std::size_t i = 0; i < 4; ++i) EXPECT_NEAR(lens.intrinsics[i], truth[i], 4 * std::sqrt(lens.covariance[i * 9]) + 0.05) << i;

  // What is left of the corners goes into the file for the report.
  const auto corners = acquire::read_corner_residuals(folder / "lens.cameramodel");
  ASSERT_EQ(corners.size(), 350u);
  double sum = 0;
  for (const auto& c : corners) sum += glm::dot(c.residual, c.residual);
  const std::size_t at = result.out.find("px, rms ") + 8;
  EXPECT_NEAR(std::sqrt(sum / 350), std::stod(result.out.substr(at)), 2e-3);

  const std::string rig = "[rig]\nname = \"r\"\nkind = \"simulated\"\n[camera]\nwidth_px = 480\nheight_px = 360\nlayout = \"mono\"\nbits = 12\nlens_file = \"lens.cameramodel\"\nposition_mm = [0, 0, 1000]\n"
                          "[sensor]\nsensitivity_e_per_s = 5e5\n[[lights]]\nposition_mm = [0, 125, 587]\n[plan]\nangles_deg = [0]\nexposures_ms = [10]\n";
  test::write_file(folder / "rig.toml", rig);
  const acquire::RigDescription description = acquire::read_rig(folder / "rig.toml");
  EXPECT_EQ(description.geometry.camera.focal.x, lens.intrinsics[0]);
  EXPECT_EQ(description.geometry.camera.distortion[0], lens.intrinsics[4]);
  ASSERT_TRUE(description.lens);
  EXPECT_EQ(description.lens->covariance.size(), 64u);
  ASSERT_EQ(description.referenced_files.size(), 1u) << "goes into the session";

  const auto error_of = [&](std::string text, const std::string& from, const std::string& to) {
    text.replace(text.find(from), from.size(), to);
    try {
      acquire::parse_rig(text, folder / "rig.toml");
    } catch (const Error& e) {
      return std::string(e.what());
    }
    return std::string("no error");
  };
  EXPECT_NE(error_of(rig, "width_px = 480", "width_px = 640").find("camera.lens_file: was calibrated for 480 x 360 pixels, the camera has 640 x 360"), std::string::npos);
  EXPECT_NE(error_of(rig, "lens_file", "focal_length_px = 3\nlens_file").find("camera.focal_length_px: camera.lens_file says it already"), std::string::npos);
  EXPECT_NE(error_of(rig, "lens.camera", "none.camera").find("camera.lens_file: no file"), std::string::npos);
}

TEST_F(CalibrateCamera, WhatGoesWrongIsSaidInOneLine) {
  photographs(5, false);
  const auto expect = [&](const test::CommandResult& result, int code, const std::string& text) {
    EXPECT_EQ(result.exit_code, code) << text;
    EXPECT_NE(result.err.find(text), std::string::npos) << result.err;
    EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
  };
  expect(calibrate(""), 1, "fix no lens");
  expect(calibrate("", "8x6"), 1, "no board of 8x6 inner corners in any of 5 photographs; one of 7x5 is: --board-size counts inner corners, not squares");
  expect(calibrate("", "7"), 2, "--board-size 7: expected inner corners as WxH");
  expect(calibrate("", "2x5"), 2, "expected 3 to 100 inner corners");
  expect(calibrate("--model fisheye"), 2, "lens model LENSMODEL_fisheye: expected");
  for (int i = 3; i < 5; ++i) std::filesystem::remove(folder / fmt::format("b{}.tiff", i));
  expect(calibrate(""), 1, "3 boards found; expected at least 4");
  std::filesystem::remove(folder / "b1.tiff");
  test::write_file(folder / "b1.tiff", "not an image");
  expect(calibrate(""), 1, "b1.tiff");
  expect(run_lacquer("-q calibrate camera --boards '/nowhere/*' --board-size 7x5 --square-mm 30 -o x"), 1, "--boards /nowhere/*: no such file");
  EXPECT_FALSE(std::filesystem::exists(folder / "lens.cameramodel"));
}

#define LACQUER_NEEDS_MRCAL_TOOLS                                                                                                         \
  if (std::system("/usr/bin/python3 -c 'import mrcal' >/dev/null 2>&1") != 0 || std::system("which mrcal-to-cahvor >/dev/null 2>&1") != 0) \
  GTEST_SKIP() << "SKIPPED LOUDLY: mrcal's own tools are not here (Debian: mrcal, python3-mrcal)"

/// Numbers printed by a Python script that mrcal evaluates.
std::vector<double> python(const test::TemporaryFolder& folder, const std::string& script) {
  test::write_file(folder / "script.py", script);
  const std::string out = folder / "python.out";
  EXPECT_EQ(std::system(("/usr/bin/python3 " + (folder / "script.py").string() + " >" + out + " 2>&1").c_str()), 0) << brdf::read_text(out);
  std::ifstream in(out);
  std::vector<double> numbers;
  for (double number = 0; in >> number;) numbers.push_back(number);
  return numbers;
}

TEST_F(CalibrateCamera, OpenCvsBoardsAndMrcalsOwnToolsAgree) {
  LACQUER_NEEDS_SHARED_DATA("chessboard/left01.jpg");
  const std::string lens = folder / "left.cameramodel";
  for (const std::string model : {"SPLINED_STEREOGRAPHIC_order=3_Nx=11_Ny=8_fov_x_deg=66", "opencv8"}) {
    const auto result = run_lacquer(fmt::format("-q calibrate camera --boards '{}/chessboard/*.jpg' --board-size 9x6 --square-mm 25 --model {} --json -o {}", test::shared_data().string(), model, lens));
    ASSERT_EQ(result.exit_code, 0) << result.err;
    const auto j = nlohmann::json::parse(result.out);
    EXPECT_EQ(j["boards"].size(), 13u);
    EXPECT_LE(j["rms_px"].get<double>(), 0.41);
    EXPECT_LT(j["cross_validation"]["held_out_rms_px"].get<double>(), 0.25);
    LACQUER_NEEDS_MRCAL_TOOLS;
    // mrcal reads the file, finds the same minimum from our inputs, and the same uncertainty of projection.
    const auto numbers = python(folder, fmt::format(R"(
import mrcal, numpy as np
m = mrcal.cameramodel('{}')
inputs = m.optimization_inputs()
x = mrcal.optimizer_callback(**inputs)[1]
n = mrcal.num_measurements_boards(**inputs)
print(np.sqrt(np.sum(x[:n]**2) / (n / 2)))
before = inputs['intrinsics'].copy()
mrcal.optimize(**inputs)
grid = np.array([((640 - 1.) * i / 20, (480 - 1.) * j / 14) for j in range(15) for i in range(21)])
v = mrcal.unproject(grid, *m.intrinsics(), normalize=True)
print(np.max(np.abs(mrcal.project(v, m.intrinsics()[0], inputs['intrinsics'][0]) - grid)))
for distance in ({}, None):
    u = mrcal.projection_uncertainty(v * (distance or 1), m, atinfinity=distance is None, what='worstdirection-stdev', observed_pixel_uncertainty={})
    print(np.mean(u), np.max(u))
)", lens, j["board_distance_m"].get<double>(), j["corner_sigma_px"].get<double>()));
    ASSERT_EQ(numbers.size(), 6u);
    EXPECT_NEAR(numbers[0], j["rms_px"].get<double>(), 1e-9);
    EXPECT_LT(numbers[1], 0.02) << "px between our minimum and the one mrcal goes on to";
    const auto& u = j["uncertainty_px"];
    EXPECT_NEAR(numbers[2] / u["at_boards"]["mean"].get<double>(), 1, 1e-5);
    EXPECT_NEAR(numbers[3] / u["at_boards"]["worst"].get<double>(), 1, 1e-5);
    EXPECT_NEAR(numbers[4] / u["at_infinity"]["mean"].get<double>(), 1, 1e-5);
    EXPECT_NEAR(numbers[5] / u["at_infinity"]["worst"].get<double>(), 1, 1e-5);
  }
  const std::string tools = fmt::format("mrcal-to-cahvor - < {} > /dev/null && mrcal-convert-lensmodel --num-trials 1 --gridn 30 20 LENSMODEL_OPENCV4 - < {} > {}", lens, lens, (folder / "converted.cameramodel").string());
  EXPECT_EQ(std::system((tools + " 2> " + (folder / "err").string()).c_str()), 0) << brdf::read_text(folder / "err");
  EXPECT_EQ(acquire::read_lens(folder / "converted.cameramodel").model, "LENSMODEL_OPENCV4");
}

}  // namespace
}  // namespace lacquer
