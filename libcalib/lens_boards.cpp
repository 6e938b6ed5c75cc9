#include "libcalib/lens_boards.h"

#include <fmt/format.h>

#include <algorithm>
#include <glm/geometric.hpp>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "libbrdf/error.h"

#if LACQUER_MRGINGHAM
#include <mrgingham/mrgingham.hh>
#endif

namespace lacquer::calib {

namespace {

/// 8 bits of grey; the darkest and brightest thousandth of the values become 0 and 255.
cv::Mat grey_of(const acquire::RawFrame& frame) {
  using acquire::PixelLayout;
  cv::Mat raw(frame.height, frame.width, frame.layout == PixelLayout::rgb ? CV_16UC3 : CV_16UC1, const_cast<std::uint16_t*>(frame.data.data())), grey;
  switch (frame.layout) {  // OpenCV names a mosaic by its second row's second and third pixel
    case PixelLayout::mono: grey = raw; break;
    case PixelLayout::rgb: cv::cvtColor(raw, grey, cv::COLOR_RGB2GRAY); break;
    case PixelLayout::bayer_rggb: cv::cvtColor(raw, grey, cv::COLOR_BayerBG2GRAY); break;
    case PixelLayout::bayer_grbg: cv::cvtColor(raw, grey, cv::COLOR_BayerGB2GRAY); break;
    case PixelLayout::bayer_gbrg: cv::cvtColor(raw, grey, cv::COLOR_BayerGR2GRAY); break;
    case PixelLayout::bayer_bggr: cv::cvtColor(raw, grey, cv::COLOR_BayerRG2GRAY); break;
  }
  std::vector<std::uint16_t> values(grey.begin<std::uint16_t>(), grey.end<std::uint16_t>());
  const auto rank = [&](std::size_t thousandths) {
    const auto at = values.begin() + static_cast<std::ptrdiff_t>((values.size() - 1) * thousandths / 1000);
    std::nth_element(values.begin(), at, values.end());
    return static_cast<double>(*at);
  };
  const double low = rank(1), high = std::max(rank(999), low + 1);
  cv::Mat result;
  grey.convertTo(result, CV_8U, 255 / (high - low), -low * 255 / (high - low));
  return result;
}

/// Distance of the closest pair of neighbours on the board, pixels.
double smallest_spacing(const std::vector<cv::Point2f>& corners, const BoardShape& shape) {
  double smallest = 1e9;
  const auto columns = static_cast<std::size_t>(shape.columns);
  for (std::size_t i = 0; i < corners.size(); ++i) {
    if (i % columns + 1 < columns) smallest = std::min(smallest, cv::norm(corners[i + 1] - corners[i]));
    if (i + columns < corners.size()) smallest = std::min(smallest, cv::norm(corners[i + columns] - corners[i]));
  }
  return smallest;
}

std::optional<std::vector<glm::dvec2>> find_by_opencv(const cv::Mat& grey, const BoardShape& shape) {
  std::vector<cv::Point2f> corners;
  const cv::Size size(shape.columns, shape.rows);
  if (!cv::findChessboardCorners(grey, size, corners, cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE) &&
      !cv::findChessboardCornersSB(grey, size, corners, cv::CALIB_CB_NORMALIZE_IMAGE | cv::CALIB_CB_EXHAUSTIVE))
    return std::nullopt;
  // A window as wide as the neighbouring corner would be drawn to it.
  const int half = std::clamp(static_cast<int>(0.35 * smallest_spacing(corners, shape)), 2, 11);
  cv::cornerSubPix(grey, corners, cv::Size(half, half), cv::Size(-1, -1), cv::TermCriteria(cv::TermCriteria::EPS | cv::TermCriteria::COUNT, 100, 1e-4));
  std::vector<glm::dvec2> result;
  for (const cv::Point2f& c : corners) result.emplace_back(c.x, c.y);
  return result;
}

#if LACQUER_MRGINGHAM
std::optional<std::vector<glm::dvec2>> find_by_mrgingham(const cv::Mat& grey, const BoardShape& shape) {
  std::vector<mrgingham::PointDouble> points;
  if (mrgingham::find_chessboard_from_image_array(points, nullptr, shape.columns, grey) < 0 || points.size() != shape.n_corners()) return std::nullopt;
  std::vector<glm::dvec2> result;
  for (const auto& p : points) result.emplace_back(p.x, p.y);
  return result;
}
#endif

}  // namespace

void BoardShape::validate() const {
  if (columns < 3 || rows < 3 || columns > 100 || rows > 100)
    throw Error(ErrorCode::usage, fmt::format("board size: expected 3 to 100 inner corners each way, got {}x{}", columns, rows));
  if (!(square_m >= 1e-5 && square_m <= 10)) throw Error(ErrorCode::usage, fmt::format("square: expected a side of 0.01 to 10000 mm, got {} mm", square_m * 1e3));
}

bool has_mrgingham() { return LACQUER_MRGINGHAM != 0; }

std::optional<std::vector<glm::dvec2>> find_board(const acquire::RawFrame& frame, const BoardShape& shape, CornerFinder finder) {
  const cv::Mat grey = grey_of(frame);
  if (finder == CornerFinder::opencv) return find_by_opencv(grey, shape);
  if (shape.columns != shape.rows)
    throw Error(ErrorCode::usage, fmt::format("mrgingham finds boards with as many rows as columns of corners only, not {}x{}; use OpenCV", shape.columns, shape.rows));
#if LACQUER_MRGINGHAM
  return find_by_mrgingham(grey, shape);
#else
  throw Error(ErrorCode::usage, "this build has no mrgingham (libmrgingham-dev); use OpenCV");
#endif
}

}  // namespace lacquer::calib
