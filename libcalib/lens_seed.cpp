#include "libcalib/lens_seed.h"

#include <cmath>
#include <opencv2/calib3d.hpp>

#include "libbrdf/error.h"

namespace lacquer::calib {

namespace {

std::vector<cv::Point3f> board_points(const BoardShape& board) {
  std::vector<cv::Point3f> points;
  for (int y = 0; y < board.rows; ++y)
    for (int x = 0; x < board.columns; ++x) points.emplace_back(static_cast<float>(x * board.square_m), static_cast<float>(y * board.square_m), 0.f);
  return points;
}

std::vector<cv::Point2f> image_points(const BoardView& view) {
  std::vector<cv::Point2f> points;
  for (const glm::dvec2& c : view.corners) points.emplace_back(static_cast<float>(c.x), static_cast<float>(c.y));
  return points;
}

/// Pinhole at the image's centre, poses by PnP; then all of LENSMODEL_OPENCV4. Negative: PnP or mrcal failed.
double solve_from(LensProblem& p, const std::vector<BoardView>& views, double focal) {
  const double cx = 0.5 * (p.width - 1), cy = 0.5 * (p.height - 1);
  const cv::Mat camera = (cv::Mat_<double>(3, 3) << focal, 0, cx, 0, focal, cy, 0, 0, 1);
  p.model = "LENSMODEL_OPENCV4";
  p.intrinsics = {focal, focal, cx, cy, 0, 0, 0, 0};
  p.poses.clear();
  const auto points = board_points(p.board);
  try {
    for (const BoardView& view : views) {
      cv::Vec3d r, t;
      if (!cv::solvePnP(points, image_points(view), camera, cv::noArray(), r, t) || !(t[2] > 0)) return -1;
      p.poses.push_back({r[0], r[1], r[2], t[0], t[1], t[2]});
    }
    const LensFreedom poses{.core = false, .distortion = false, .warp = false}, core{.distortion = false, .warp = false}, all{.warp = false};
    solve_lens(p, poses);
    solve_lens(p, core);
    const double rms = solve_lens(p, all).rms_px;
    return p.intrinsics[0] > 0 && p.intrinsics[1] > 0 ? rms : -1;
  } catch (const cv::Exception&) {
    return -1;
  } catch (const Error&) {
    return -1;
  }
}

double closed_form_focal(const std::vector<BoardView>& views, const BoardShape& board, int width, int height) {
  const std::vector<std::vector<cv::Point3f>> objects(views.size(), board_points(board));
  std::vector<std::vector<cv::Point2f>> images;
  for (const BoardView& view : views) images.push_back(image_points(view));
  try {
    return cv::initCameraMatrix2D(objects, images, cv::Size(width, height), 1).at<double>(0, 0);
  } catch (const cv::Exception&) {
    return 0;
  }
}

}  // namespace

LensProblem seed_lens(const std::vector<BoardView>& views, const BoardShape& board, int width, int height, double focal_px) {
  LensProblem p;
  p.width = width, p.height = height, p.board = board;
  for (const BoardView& view : views)
    for (const glm::dvec2& c : view.corners) p.observed.emplace_back(c.x, c.y, 1);
  const double first = focal_px > 0 ? focal_px : closed_form_focal(views, board, width, height);
  std::vector<double> focals;
  if (std::isfinite(first) && first > 0.05 * width && first < 100.0 * width) focals.push_back(first);
  for (const double f : {0.3, 0.5, 0.8, 1.3, 2.2, 4.0, 8.0}) focals.push_back(f * width);

  constexpr double good_px = 1;  // a lens of more than four distortion parameters leaves this much to OPENCV4
  LensProblem best;
  double best_rms = -1;
  for (const double focal : focals) {
    LensProblem candidate = p;
    const double rms = solve_from(candidate, views, focal);
    if (rms < 0 || (best_rms >= 0 && rms >= best_rms)) continue;
    best = candidate, best_rms = rms;
    if (rms < good_px) break;
  }
  if (best_rms < 0)
    throw Error(ErrorCode::input, "these boards fix no lens: no focal length from 0.3 to 8 image widths explains them; are they of one board and one camera?");
  return best;
}

}  // namespace lacquer::calib
