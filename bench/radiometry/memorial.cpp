#include "bench/radiometry/memorial.h"

#include <fmt/format.h>

#include <cmath>
#include <fstream>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "bench/radiometry/errors.h"
#include "bench/radiometry/peers.h"
#include "libbrdf/error.h"
#include "libcalib/frame_list.h"

namespace lacquer::bench {

namespace {

std::vector<acquire::RawFrame> read_frames(const std::filesystem::path& folder) {
  std::vector<acquire::RawFrame> frames;
  std::ifstream times(folder / "shutter_times.txt");
  std::string time;
  for (int i = 61; times >> time; ++i) {
    frames.push_back(acquire::read_frame((folder / fmt::format("memorial00{}.png", i)).string(), 8, acquire::PixelLayout::rgb));
    const auto slash = time.find('/');
    frames.back().actual.exposure_s = slash == std::string::npos ? std::stod(time) : std::stod(time.substr(0, slash)) / std::stod(time.substr(slash + 1));
  }
  if (frames.size() != 16) throw Error(ErrorCode::file, fmt::format("{}: expected 16 frames, got {}", folder.string(), frames.size()));
  return frames;
}

/// The scans are shifted against each other and framed in pure blue: pixels within 4 of that in any frame, or of the edge, are left out.
cv::Mat outside(const std::vector<acquire::RawFrame>& frames) {
  cv::Mat border(frames[0].height, frames[0].width, CV_8U, cv::Scalar(0));
  for (const auto& f : frames)
    for (std::size_t i = 0; i < border.total(); ++i)
      if (f.data[3 * i] == 0 && f.data[3 * i + 1] == 0 && f.data[3 * i + 2] == 255) border.data[i] = 1;
  cv::rectangle(border, cv::Rect(0, 0, border.cols, border.rows), cv::Scalar(1));
  cv::dilate(border, border, cv::getStructuringElement(cv::MORPH_RECT, {9, 9}));
  return border;
}

/// `a`, `b`: log2 radiance, R G B interleaved.
Agreement agreement(const std::vector<double>& a, const std::vector<double>& b) {
  std::array<double, 3> mean_a{}, mean_b{};
  const double n = static_cast<double>(a.size()) / 3;
  for (std::size_t i = 0; i < a.size(); ++i) mean_a[i % 3] += a[i] / n, mean_b[i % 3] += b[i] / n;
  double aa = 0, ab = 0, bb = 0;
  std::vector<double> differences;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const double da = a[i] - mean_a[i % 3], db = b[i] - mean_b[i % 3];
    aa += da * da, ab += da * db, bb += db * db;
    differences.push_back(da - db);
  }
  return {ab / std::sqrt(aa * bb), quantile(differences, 0.05), quantile(differences, 0.95)};
}

}  // namespace

std::optional<MemorialResult> compare_memorial(const std::filesystem::path& folder) {
  if (!std::filesystem::is_directory(folder)) return std::nullopt;
  const auto frames = read_frames(folder);
  const cv::Mat reference = cv::imread((folder / "memorial.hdr").string(), cv::IMREAD_UNCHANGED);  // B G R
  if (reference.type() != CV_32FC3 || reference.total() * 3 != frames[0].data.size())
    throw Error(ErrorCode::file, (folder / "memorial.hdr").string() + ": expected a colour picture of the frames' size");
  const cv::Mat left_out = outside(frames);

  MemorialResult result;
  calib::MergedPhotographs ours;
  result.ours_s = time_repeats(1, [&] { ours = calib::merge_photographs(frames, {}); });
  const PeerResult opencv = run_opencv_robertson(frames, 1);
  result.opencv_s.min_s = result.opencv_s.median_s = opencv.response.min_s + opencv.merge.min_s;
  std::vector<double> log_ours, log_opencv, log_reference;
  for (std::size_t i = 0; i < left_out.total(); ++i) {
    const float* r = reference.ptr<float>() + 3 * i;
    const float *x = &ours.image.radiance[3 * i], *y = &opencv.radiance[3 * i];
    if (left_out.data[i] || !(std::min({r[0], r[1], r[2], x[0], x[1], x[2], y[0], y[1], y[2]}) > 0)) continue;
    for (int c = 0; c < 3; ++c) {
      log_reference.push_back(std::log2(r[2 - c]));
      log_ours.push_back(std::log2(x[c]));
      log_opencv.push_back(std::log2(y[c]));
    }
  }
  result.n = log_ours.size();
  result.ours = agreement(log_ours, log_reference);
  result.opencv = agreement(log_opencv, log_reference);
  return result;
}

}  // namespace lacquer::bench
