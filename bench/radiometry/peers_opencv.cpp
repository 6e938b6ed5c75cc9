#include <opencv2/core.hpp>
#include <opencv2/photo.hpp>

#include "bench/radiometry/peers.h"

namespace lacquer::bench {

namespace {

struct Pictures {
  std::vector<cv::Mat> pictures;  ///< R G B: OpenCV treats the channels alike
  std::vector<float> times;
};

Pictures pictures_of(const std::vector<acquire::RawFrame>& frames) {
  Pictures p;
  for (const auto& f : frames) {
    cv::Mat picture(f.height, f.width, CV_8UC3);
    for (std::size_t i = 0; i < f.data.size(); ++i) picture.data[i] = static_cast<std::uint8_t>(f.data[i]);
    p.pictures.push_back(picture);
    p.times.push_back(static_cast<float>(f.actual.exposure_s));
  }
  return p;
}

template <typename Calibrate, typename Merge>
PeerResult run(const std::string& name, const Pictures& p, const cv::Ptr<Calibrate>& calibrate, const cv::Ptr<Merge>& merge, int merge_repeats) {
  PeerResult result{name, {}, {}, {}, {}, {}, {}};
  cv::Mat response, radiance;
  result.response = time_repeats(1, [&] { calibrate->process(p.pictures, response, p.times); });
  result.merge = time_repeats(merge_repeats, [&] { merge->process(p.pictures, radiance, p.times, response); });
  result.radiance.assign(radiance.ptr<float>(), radiance.ptr<float>() + radiance.total() * 3);
  for (int c = 0; c < 3; ++c)
    for (int v = 0; v < 256; ++v) result.curve[static_cast<std::size_t>(c)].push_back(response.at<cv::Vec3f>(v)[c]);
  return result;
}

}  // namespace

PeerResult run_opencv_robertson(const std::vector<acquire::RawFrame>& frames, int merge_repeats) {
  return run("OpenCV Robertson", pictures_of(frames), cv::createCalibrateRobertson(), cv::createMergeRobertson(), merge_repeats);
}

PeerResult run_opencv_debevec(const std::vector<acquire::RawFrame>& frames, int merge_repeats) {
  return run("OpenCV Debevec", pictures_of(frames), cv::createCalibrateDebevec(), cv::createMergeDebevec(), merge_repeats);
}

}  // namespace lacquer::bench
