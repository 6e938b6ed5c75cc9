#include "libcalib/rerender.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libcalib/shown_rgb.h"

namespace lacquer::calib {

namespace {

ViewError view_error(const RadianceImage& image, const Sampler::Prediction& prediction) {
  ViewError e;
  double sum_difference2 = 0, sum_measured2 = 0, sum_abs_log = 0, sum_log = 0;
  std::size_t n_log = 0;
  for (std::size_t i = 0; i < image.radiance.size(); ++i) {
    const bool measured_well = image.flags[i] == PixelFlag::valid || image.flags[i] == PixelFlag::dark;
    if (!prediction.used[i] || !measured_well) continue;
    const double measured = image.radiance[i], predicted = prediction.radiance[i];
    sum_difference2 += (predicted - measured) * (predicted - measured);
    sum_measured2 += measured * measured;
    ++e.n_values;
    if (measured > 5 * std::sqrt(image.variance[i]) && predicted > 0) {
      const double ratio = std::log(predicted / measured);
      sum_log += ratio;
      sum_abs_log += std::abs(ratio);
      ++n_log;
    }
  }
  if (sum_measured2 > 0) e.relative_rms = std::sqrt(sum_difference2 / sum_measured2);
  if (n_log > 0) {
    e.mean_abs_log = sum_abs_log / static_cast<double>(n_log);
    e.bias_log = sum_log / static_cast<double>(n_log);
  }
  return e;
}

/// shown_rgb as OpenCV has it.
cv::Mat to_bgr(const std::vector<float>& values, const std::vector<bool>& used, const RadianceImage& shape, const glm::dvec3& white_balance) {
  const ShownRgb shown = shown_rgb(values, used, shape, white_balance);
  cv::Mat picture(shown.height, shown.width, CV_32FC3);
  for (int y = 0; y < shown.height; ++y)
    for (int x = 0; x < shown.width; ++x) {
      const glm::vec3& rgb = shown.rgb[static_cast<std::size_t>(y) * static_cast<std::size_t>(shown.width) + static_cast<std::size_t>(x)];
      picture.at<cv::Vec3f>(y, x) = {rgb.z, rgb.y, rgb.x};
    }
  return picture;
}

float srgb_code(float linear) {
  const float x = std::clamp(linear, 0.0f, 1.0f);
  return x <= 0.0031308f ? 12.92f * x : 1.055f * std::pow(x, 1 / 2.4f) - 0.055f;
}

/// Where the sphere is in a picture of to_bgr, a few pixels larger.
cv::Rect picture_box(const acquire::RigGeometry& rig, const RadianceImage& image, cv::Size picture) {
  const int step = image.width / picture.width;
  cv::Rect box;
  for (int y = 0; y < picture.height; ++y)
    for (int x = 0; x < picture.width; ++x)
      if (acquire::trace(rig, glm::dvec2(x * step, y * step))) box |= cv::Rect(x, y, 1, 1);
  if (box.empty()) return {0, 0, picture.width, picture.height};
  return cv::Rect(box.x - 3, box.y - 3, box.width + 6, box.height + 6) & cv::Rect({0, 0}, picture);
}

/// Photograph, re-rendering and difference side by side, cropped to the sphere, 8-bit.
cv::Mat picture_row(const RadianceImage& image, const Sampler::Prediction& prediction, const Calibration& calibration,
                    const std::string& label) {
  const glm::dvec3 balance = calibration.dn_per_radiance / calibration.dn_per_radiance.y * calibration.geometry.lights[0].intensity /
                             calibration.geometry.lights[0].intensity.y;
  cv::Mat a = to_bgr(image.radiance, prediction.used, image, balance), b = to_bgr(prediction.radiance, prediction.used, image, balance);

  std::vector<float> lit;
  for (int y = 0; y < a.rows; ++y)
    for (int x = 0; x < a.cols; ++x)
      if (const float green = a.at<cv::Vec3f>(y, x)[1]; green != 0) lit.push_back(green);
  float white = 1;
  if (!lit.empty()) {
    const auto nth = lit.begin() + static_cast<std::ptrdiff_t>(0.97 * static_cast<double>(lit.size() - 1));
    std::nth_element(lit.begin(), nth, lit.end());
    white = std::max(*nth * 1.25f, 1e-30f);
  }
  const cv::Rect box = picture_box(calibration.geometry, image, a.size());
  a = a(box);
  b = b(box);
  cv::Mat row(a.rows, a.cols * 3, CV_8UC3);
  for (int y = 0; y < a.rows; ++y)
    for (int x = 0; x < a.cols; ++x) {
      const cv::Vec3f p = a.at<cv::Vec3f>(y, x) / white, q = b.at<cv::Vec3f>(y, x) / white;
      const float d = std::clamp((q[0] + q[1] + q[2] - p[0] - p[1] - p[2]) / 3 / 0.25f, -1.0f, 1.0f);
      for (int c = 0; c < 3; ++c) {
        row.at<cv::Vec3b>(y, x)[c] = cv::saturate_cast<uchar>(255 * srgb_code(p[c]));
        row.at<cv::Vec3b>(y, x + a.cols)[c] = cv::saturate_cast<uchar>(255 * srgb_code(q[c]));
      }
      row.at<cv::Vec3b>(y, x + 2 * a.cols) = d >= 0 ? cv::Vec3b(cv::saturate_cast<uchar>(128 - 128 * d), cv::saturate_cast<uchar>(128 - 128 * d), cv::saturate_cast<uchar>(128 + 127 * d))
                                                    : cv::Vec3b(cv::saturate_cast<uchar>(128 - 127 * d), cv::saturate_cast<uchar>(128 + 128 * d), cv::saturate_cast<uchar>(128 + 128 * d));
    }
  constexpr int row_width = 960;
  cv::resize(row, row, cv::Size(row_width, std::max(1, row.rows * row_width / row.cols)), 0, 0,
             row.cols < row_width ? cv::INTER_LINEAR : cv::INTER_AREA);
  cv::copyMakeBorder(row, row, 26, 4, 0, 0, cv::BORDER_CONSTANT, cv::Scalar::all(255));
  cv::putText(row, label, {4, 18}, cv::FONT_HERSHEY_SIMPLEX, 0.5, cv::Scalar::all(0), 1, cv::LINE_AA);
  return row;
}

/// The centres of `n` equal parts of those views whose light lights a good part of what the camera sees.
std::vector<std::size_t> views_to_picture(const acquire::Session& session, const Calibration& calibration, int n) {
  const glm::dvec3 camera = calibration.geometry.cam_from_rig.inverse() * glm::dvec3(0);
  std::vector<std::size_t> lit, chosen;
  for (const std::size_t i : session.views_of(acquire::ViewKind::measurement)) {
    const auto& view = session.views[i];
    const auto light = calibration.geometry.place_light(static_cast<std::size_t>(view.light), calibration.turntable_scale * view.turntable_angle);
    const glm::dvec3 towards = light.distant ? light.direction : glm::normalize(light.position);
    if (glm::dot(towards, glm::normalize(camera)) > -0.35) lit.push_back(i);  // up to 110 degrees from the camera
  }
  const std::size_t parts = std::min(lit.size(), static_cast<std::size_t>(std::max(n, 0)));
  for (std::size_t k = 0; k < parts; ++k) chosen.push_back(lit[(2 * k + 1) * lit.size() / (2 * parts)]);
  return chosen;
}

}  // namespace

std::vector<ViewError> rerender_session(const acquire::Session& session, const Calibration& calibration, const brdf::Brdf& paint,
                                        const RerenderOptions& options, const std::filesystem::path& picture, const Progress& progress) {
  const Sampler sampler(calibration, session.rig.mask, session.rig.sensor.layout, options.samples);
  const std::vector<std::size_t> views = session.views_of(acquire::ViewKind::measurement);
  const std::vector<std::size_t> pictured = views_to_picture(session, calibration, options.n_pictured);
  std::vector<ViewError> errors;
  std::vector<cv::Mat> rows;
  for (std::size_t i = 0; i < views.size(); ++i) {
    const auto& view = session.views[views[i]];
    const RadianceImage image = read_radiance(session.radiance_path(view));
    const auto prediction = sampler.predict_view(paint, illumination_of(view, calibration));
    if (prediction.radiance.size() != image.radiance.size())
      throw Error(ErrorCode::input, fmt::format("{}: size or layout differs from the session's camera", session.radiance_path(view).string()));
    errors.push_back(view_error(image, prediction));
    errors.back().view = view.id;
    if (!picture.empty() && std::find(pictured.begin(), pictured.end(), views[i]) != pictured.end()) {
      const std::string label = fmt::format("{}: photograph | re-rendering | difference (+-25 % of white)   rel. RMS {:.1f} %", view.id,
                                            100 * errors.back().relative_rms);
      rows.push_back(picture_row(image, prediction, calibration, label));
    }
    if (progress) progress("re-render", i + 1, views.size());
  }
  if (!rows.empty()) {
    cv::Mat all;
    cv::vconcat(rows, all);
    std::vector<uchar> png;
    cv::imencode(".png", all, png);
    brdf::write_text_atomically(picture, std::string(png.begin(), png.end()));
  }
  return errors;
}

}  // namespace lacquer::calib
