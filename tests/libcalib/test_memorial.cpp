#include <algorithm>
#include <cmath>
#include <iostream>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/photo.hpp>

#include "libcalib/frame_list.h"
#include "test_support.h"

/// Debevec's memorial church: film scans, 32 s to 1/1024 s, with his own radiance map (Debevec and Malik 1997).
namespace lacquer::calib {
namespace {

struct Memorial {
  std::vector<acquire::RawFrame> frames;
  std::vector<cv::Mat> pictures;  ///< BGR
  cv::Mat reference;              ///< BGR, float
  std::vector<bool> inside;       ///< per pixel: not in nor near a pure blue border of any frame
};

Memorial read_memorial() {
  const std::filesystem::path folder = test::shared_data() / "brackets/memorial";
  const test::TemporaryFolder lists;
  std::string list = "file,exposure_s\n", time;
  std::ifstream times(folder / "shutter_times.txt");
  for (int i = 61; times >> time; ++i) list += std::filesystem::absolute(folder).string() + "/memorial00" + std::to_string(i) + ".png," + time + "\n";
  test::write_file(lists / "list.csv", list);
  Memorial m;
  m.frames = read_listed_frames(lists / "list.csv", 8, acquire::PixelLayout::mono);
  m.reference = cv::imread((folder / "memorial.hdr").string(), cv::IMREAD_UNCHANGED);
  cv::Mat border = cv::Mat::zeros(m.frames[0].height, m.frames[0].width, CV_8U);
  for (const auto& f : m.frames) {
    cv::Mat picture(f.height, f.width, CV_8UC3);
    for (int y = 0; y < f.height; ++y)
      for (int x = 0; x < f.width; ++x) {
        const std::uint16_t* rgb = &f.data[static_cast<std::size_t>(3 * (y * f.width + x))];
        picture.at<cv::Vec3b>(y, x) = {static_cast<std::uint8_t>(rgb[2]), static_cast<std::uint8_t>(rgb[1]), static_cast<std::uint8_t>(rgb[0])};
        if (rgb[0] == 0 && rgb[1] == 0 && rgb[2] == 255) border.at<std::uint8_t>(y, x) = 1;
      }
    m.pictures.push_back(picture);
  }
  cv::Mat near_border;
  constexpr int margin = 4;
  cv::dilate(border, near_border, cv::getStructuringElement(cv::MORPH_RECT, {2 * margin + 1, 2 * margin + 1}));
  for (int y = 0; y < border.rows; ++y)
    for (int x = 0; x < border.cols; ++x) {
      const bool edge = x < margin || y < margin || x >= border.cols - margin || y >= border.rows - margin;
      m.inside.push_back(!edge && near_border.at<std::uint8_t>(y, x) == 0);
    }
  return m;
}

struct Agreement {
  double correlation = 0;  ///< of log2, all channels together after each channel's own mean is removed
  double low = 0, high = 0;  ///< 5th and 95th percentile of the difference, stops
};

/// `value(i, c)`: radiance of pixel i, channel c (R G B).
template <typename Value>
Agreement agreement(const Memorial& m, const Value& value) {
  double sab = 0, saa = 0, sbb = 0;
  std::vector<double> differences;
  for (int c = 0; c < 3; ++c) {
    std::vector<double> a, b;
    for (std::size_t i = 0; i < m.inside.size(); ++i) {
      const double reference = m.reference.at<cv::Vec3f>(static_cast<int>(i))[2 - c], ours = value(i, c);
      if (!m.inside[i] || !(reference > 0) || !(ours > 0)) continue;
      a.push_back(std::log2(ours));
      b.push_back(std::log2(reference));
    }
    const double mean_a = cv::mean(a)[0], mean_b = cv::mean(b)[0];
    for (std::size_t i = 0; i < a.size(); ++i) {
      const double da = a[i] - mean_a, db = b[i] - mean_b;
      sab += da * db, saa += da * da, sbb += db * db;
      differences.push_back(da - db);
    }
  }
  std::sort(differences.begin(), differences.end());
  const auto percentile = [&](double p) { return differences[static_cast<std::size_t>(p * static_cast<double>(differences.size()))]; };
  return {sab / std::sqrt(saa * sbb), percentile(0.05), percentile(0.95)};
}

TEST(Memorial, AgreesWithDebevecsOwnRadianceMap) {
  LACQUER_NEEDS_SHARED_DATA("brackets/memorial");
  const Memorial m = read_memorial();
  ASSERT_EQ(m.frames.size(), 16u);
  ASSERT_EQ(m.reference.total(), m.inside.size());
  const MergedPhotographs merged = merge_photographs(m.frames, {});
  const Agreement ours = agreement(m, [&](std::size_t i, int c) { return merged.image.radiance[3 * i + static_cast<std::size_t>(c)]; });

  // OpenCV's merge with OUR response: another implementation of the merge, other weights. (OpenCV's own Robertson response takes
  // seconds to calibrate; with it its merge reaches 0.9982: bench/radiometry.sh.)
  std::vector<float> times;
  for (const auto& f : m.frames) times.push_back(static_cast<float>(f.actual.exposure_s));
  cv::Mat response(256, 1, CV_32FC3), opencv;
  for (int v = 0; v < 256; ++v)
    for (int c = 0; c < 3; ++c)
      response.at<cv::Vec3f>(v)[2 - c] = static_cast<float>(merged.response.curves[static_cast<std::size_t>(c)].exposure[static_cast<std::size_t>(v)]);
  cv::createMergeRobertson()->process(m.pictures, opencv, times, response);
  const Agreement theirs = agreement(m, [&](std::size_t i, int c) { return opencv.at<cv::Vec3f>(static_cast<int>(i))[2 - c]; });
  std::vector<double> ratios;
  for (std::size_t i = 0; i < m.inside.size(); ++i)
    if (m.inside[i]) ratios.push_back(std::abs(std::log2(merged.image.radiance[3 * i + 1] / opencv.at<cv::Vec3f>(static_cast<int>(i))[1])));
  std::nth_element(ratios.begin(), ratios.begin() + static_cast<std::ptrdiff_t>(ratios.size() / 2), ratios.end());
  const double median_difference = ratios[ratios.size() / 2];

  double clipped = 0, dark = 0;
  for (const PixelFlag flag : merged.image.flags) clipped += flag == PixelFlag::clipped, dark += flag == PixelFlag::dark;
  std::cout << "memorial: log2 correlation with memorial.hdr " << ours.correlation << " (OpenCV's merge with our response " << theirs.correlation
            << "), 5-95 % spread " << ours.low << " .. " << ours.high << " stops (" << theirs.low << " .. " << theirs.high << "), median difference to OpenCV " << median_difference << " stops; "
            << merged.estimate->iterations << " iterations, residual " << merged.estimate->residual_rms << ", relative noise "
            << merged.noise.relative_noise << ", gain " << merged.noise.gain_e_per_dn << " e-/DN, " << clipped << " clipped, " << dark
            << " dark values\n";
  EXPECT_GE(ours.correlation, 0.999);
  EXPECT_GE(ours.correlation, theirs.correlation);
  EXPECT_TRUE(merged.estimate->converged);
  EXPECT_LT(median_difference, 0.1) << "stops; film grain and registration differ by 4 % between frames, weights by more";
}

}  // namespace
}  // namespace lacquer::calib
