#include <algorithm>

#include "libbrdf/error.h"
#include "libcalib/lens_calibration.h"
#include "libcalib/simulated_boards.h"
#include "test_support.h"

namespace lacquer::calib {
namespace {

using test::SimulatedBoards;

LensOptions options_of(const std::string& model) {
  LensOptions o;
  o.model = model;
  o.cross_validate = false;
  return o;
}

LensCalibration calibrate(const SimulatedBoards& boards, std::size_t n, unsigned seed, const LensOptions& options) {
  return calibrate_lens(boards.views(n, seed), boards.board, boards.camera.width, boards.camera.height, options);
}

std::vector<double> truth_of(const acquire::CameraModel& c, std::size_t n) {
  std::vector<double> truth{c.focal.x, c.focal.y, c.centre.x, c.centre.y};
  truth.insert(truth.end(), c.distortion.begin(), c.distortion.end());
  truth.resize(n);
  return truth;
}

/// Largest difference of the pixels of two lenses over the image, the camera's rotation being the same.
double largest_difference(const acquire::CameraModel& a, const acquire::CameraModel& b) {
  double largest = 0;
  for (int y = 0; y < a.height; y += 64)
    for (int x = 0; x < a.width; x += 64) {
      const auto ray = a.unproject({x, y});
      const auto q = ray ? b.project(ray->direction) : std::nullopt;
      if (q) largest = std::max(largest, glm::length(*q - glm::dvec2(x, y)));
    }
  return largest;
}

TEST(LensCalibration, CornersWithoutNoiseGiveTheLensAndTheBendOfTheBoard) {
  SimulatedBoards boards{.camera = test::usual_camera(), .noise_px = 0, .warp_x = 4e-4, .warp_y = -2e-4};
  const LensCalibration c = calibrate(boards, 20, 1, options_of("LENSMODEL_OPENCV4"));
  // Not exact: mrcal pulls the distortion a little towards 0.
  EXPECT_LT(c.rms_px, 2e-3);
  EXPECT_LT(largest_difference(boards.camera, acquire::camera_of(c.lens, "x")), 0.01);
  EXPECT_NEAR(c.warp_m[0], 4e-4, 2e-6);
  EXPECT_NEAR(c.warp_m[1], -2e-4, 2e-6);
  EXPECT_EQ(c.n_outliers, 0u) << "what is off by less than 0.02 px is none";
  EXPECT_EQ(c.boards.size(), 20u);
}

TEST(LensCalibration, TruthLiesWithinTheStatedErrorsOverSeeds) {
  SimulatedBoards boards{.camera = test::usual_camera(), .noise_px = 0.15, .warp_x = 2e-4};
  constexpr unsigned n_seeds = 24;
  const auto truth = truth_of(boards.camera, 8);
  int inside = 0, n = 0;
  double chi = 0, sigma = 0;
  for (unsigned seed = 0; seed < n_seeds; ++seed) {
    const LensCalibration c = calibrate(boards, 20, 100 + seed, options_of("LENSMODEL_OPENCV4"));
    for (std::size_t i = 0; i < 8; ++i) {
      const double pull = (c.lens.intrinsics[i] - truth[i]) / std::sqrt(c.lens.covariance[i * 8 + i]);
      chi += pull * pull;
      inside += std::abs(pull) < 1.96;
      ++n;
    }
    const double pull = (c.warp_m[0] - 2e-4) / c.warp_sigma_m[0];
    chi += pull * pull, inside += std::abs(pull) < 1.96, ++n;
    sigma += c.sigma_px / n_seeds;
  }
  EXPECT_NEAR(sigma, 0.15, 0.002);
  // 216 pulls, several of them correlated within a seed: 95 % +- 2.5 %, mean square 1 +- 0.17.
  EXPECT_NEAR(static_cast<double>(inside) / n, 0.95, 0.05);
  EXPECT_NEAR(chi / n, 1.0, 0.35);
}

TEST(LensCalibration, MovedCornersAreFoundAndLeftOut) {
  SimulatedBoards boards{.camera = test::usual_camera(), .noise_px = 0.1};
  auto views = boards.views(16, 3);
  views[2].corners[10].x += 6;
  views[7].corners[33].y -= 4;
  views[7].corners[0] += glm::dvec2(2, 2);
  const LensCalibration c = calibrate_lens(views, boards.board, 1360, 1024, options_of("LENSMODEL_OPENCV4"));
  EXPECT_GE(c.boards[2].n_outliers, 1u);
  EXPECT_GE(c.boards[7].n_outliers, 2u);
  EXPECT_LE(c.n_outliers, 6u) << "4 sigma: 0.1 of 1728 coordinates by chance, more once the limit falls";
  EXPECT_NEAR(c.sigma_px, 0.1, 0.006);
}

TEST(LensCalibration, TheRationalModelFollowsAVeryShortFocalLength) {
  // 101 degrees across, with a strong barrel.
  SimulatedBoards boards{.camera = test::usual_camera(), .noise_px = 0.1, .distance = 0.12, .reach = 0.9};
  boards.camera.focal = {560, 560};
  boards.camera.distortion = {-0.2, 0.04, 0.0003, -0.0002, -0.003};
  LensOptions options = options_of("LENSMODEL_OPENCV8");
  const LensCalibration c = calibrate(boards, 30, 5, options);
  EXPECT_NEAR(c.sigma_px, 0.1, 0.006);
  EXPECT_NEAR(c.lens.intrinsics[0], 560, 5 * std::sqrt(c.lens.covariance[0]));
  const double largest = largest_difference(boards.camera, acquire::camera_of(c.lens, "x"));
  EXPECT_LT(largest, 6 * c.at_boards.worst) << c.at_boards.mean << " " << c.at_boards.worst;
}

TEST(LensCalibration, HalvesAgreeWhereTheModelIsRightAndDisagreeWhereItIsNot) {
  SimulatedBoards boards{.camera = test::usual_camera(), .noise_px = 0.1};
  boards.camera.distortion = {-0.3, 0.2, 0.001, 0, -0.09};
  LensOptions right = options_of("LENSMODEL_OPENCV5");
  right.cross_validate = true;
  const LensCalibration good = calibrate(boards, 24, 8, right);
  ASSERT_TRUE(good.cross);
  EXPECT_EQ(good.cross->n_boards[0] + good.cross->n_boards[1], 24u);
  EXPECT_LT(good.cross->held_out_rms_px, 1.1 * good.cross->fitted_rms_px);
  EXPECT_LT(good.cross->difference_rms_px, 1.5 * good.cross->expected_rms_px);
  for (const std::string& warning : good.warnings) EXPECT_EQ(warning.find("halves"), std::string::npos) << warning;

  LensOptions wrong = options_of("LENSMODEL_OPENCV4");
  wrong.cross_validate = true;
  boards.camera.distortion = {-0.3, 0.2, 0.001, 0, -0.4};
  const LensCalibration bad = calibrate(boards, 24, 8, wrong);
  EXPECT_GT(bad.sigma_px, 0.11);
}

void expect_in(const std::string& part, const std::string& text) { EXPECT_NE(text.find(part), std::string::npos) << text; }

std::string error_of(const std::vector<BoardView>& views, const BoardShape& board, const LensOptions& options = options_of("LENSMODEL_OPENCV4")) {
  try {
    calibrate_lens(views, board, 1360, 1024, options);
  } catch (const Error& e) {
    EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos);
    return e.what();
  }
  return "no error";
}

TEST(LensCalibration, BoardsThatFixNoLensAreSaid) {
  SimulatedBoards boards{.camera = test::usual_camera(), .noise_px = 0.1};
  expect_in("3 boards found; expected at least 4", error_of(boards.views(3, 1), boards.board));

  const auto one = boards.views(1, 1);
  expect_in("all 5 boards stand alike", error_of({one[0], one[0], one[0], one[0], one[0]}, boards.board));

  boards.max_tilt = 0;  // held parallel to the sensor, moved about
  expect_in("fix no lens", error_of(boards.views(12, 1), boards.board));

  expect_in("54 corners; expected 8 x 6", error_of(boards.views(5, 1), {8, 6, 0.025}));
  expect_in("square: expected a side", error_of(boards.views(5, 1), {9, 6, 0}));
  expect_in("lens model LENSMODEL_CAHVOR: expected", error_of(boards.views(5, 1), boards.board, options_of("LENSMODEL_CAHVOR")));
}

TEST(LensCalibration, TheResultIsTheSameWhateverRanBefore) {
  SimulatedBoards boards{.camera = test::usual_camera()};
  const LensCalibration a = calibrate(boards, 12, 4, options_of("LENSMODEL_OPENCV8")), b = calibrate(boards, 12, 4, options_of("LENSMODEL_OPENCV8"));
  EXPECT_EQ(acquire::cameramodel_text(a.lens, "", a.inputs), acquire::cameramodel_text(b.lens, "", b.inputs));
}

}  // namespace
}  // namespace lacquer::calib
