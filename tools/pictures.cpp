#include "tools/pictures.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "libbrdf/metrics.h"

namespace lacquer::tools {

namespace {

using brdf::TableGrid;

std::string png_bytes(const cv::Mat& image) {
  std::vector<uchar> png;
  cv::imencode(".png", image, png);
  return {png.begin(), png.end()};
}

void text(cv::Mat& image, const std::string& s, cv::Point at, double scale = 0.42) {
  cv::putText(image, s, at, cv::FONT_HERSHEY_SIMPLEX, scale, cv::Scalar::all(40), 1, cv::LINE_AA);
}

double srgb_code(double linear) {
  const double x = std::clamp(linear, 0.0, 1.0);
  return x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055;
}

}  // namespace

std::string slice_png(const SliceValue& value, double low, double high, const std::string& unit) {
  constexpr int cell = 3, left = 52, top = 8, bottom = 44, right = 70, size = 90 * cell;
  cv::Mat plot(size, size, CV_8UC3, cv::Scalar::all(200));
  cv::Mat gray(90, 90, CV_8UC1, cv::Scalar(0)), colour;
  cv::Mat defined(90, 90, CV_8UC1, cv::Scalar(0));
  for (int h = 0; h < 90; ++h)
    for (int d = 0; d < 90; ++d)
      if (const auto v = value({h, d, TableGrid::n_phi_d / 2})) {
        gray.at<uchar>(h, d) = cv::saturate_cast<uchar>(255 * std::clamp((*v - low) / (high - low), 0.0, 1.0));
        defined.at<uchar>(h, d) = 255;
      }
  cv::applyColorMap(gray, colour, cv::COLORMAP_VIRIDIS);
  cv::resize(colour, colour, plot.size(), 0, 0, cv::INTER_NEAREST);
  cv::resize(defined, defined, plot.size(), 0, 0, cv::INTER_NEAREST);
  colour.copyTo(plot, defined);

  cv::Mat image(top + size + bottom, left + size + right, CV_8UC3, cv::Scalar::all(255));
  plot.copyTo(image(cv::Rect(left, top, size, size)));
  for (int degrees = 0; degrees <= 90; degrees += 15) {
    const int x = left + degrees * cell;
    cv::line(image, {x, top + size}, {x, top + size + 4}, cv::Scalar::all(40));
    text(image, fmt::format("{}", degrees), {x - 8, top + size + 18});
  }
  for (const int degrees : {0, 1, 5, 10, 20, 40, 60, 90}) {  // the axis is nonlinear
    const int y = top + static_cast<int>(std::lround(std::sqrt(degrees / 90.0) * size));
    cv::line(image, {left - 4, y}, {left, y}, cv::Scalar::all(40));
    text(image, fmt::format("{}", degrees), {left - 28, y + 4});
  }
  text(image, "theta_d, degrees", {left + size / 2 - 56, top + size + 36});
  text(image, "th_h", {2, top + size / 2 + 30});

  cv::Mat ramp(size, 14, CV_8UC1), bar;
  for (int y = 0; y < size; ++y) ramp.row(y).setTo(255 - 255 * y / (size - 1));
  cv::applyColorMap(ramp, bar, cv::COLORMAP_VIRIDIS);
  bar.copyTo(image(cv::Rect(left + size + 10, top, 14, size)));
  text(image, fmt::format("{:.3g}", high), {left + size + 28, top + 10});
  text(image, fmt::format("{:.3g}", (low + high) / 2), {left + size + 28, top + size / 2});
  text(image, fmt::format("{:.3g}", low), {left + size + 28, top + size});
  text(image, unit, {left + size + 4, top + size + 36}, 0.36);
  return png_bytes(image);
}

std::string sphere_png(const brdf::Brdf& paint, int size) {
  const brdf::SphereImage sphere = brdf::render_lit_sphere(paint, size);
  cv::Mat image(size, size, CV_8UC3, cv::Scalar::all(24));
  for (int y = 0; y < size; ++y)
    for (int x = 0; x < size; ++x) {
      const auto i = static_cast<std::size_t>(y) * static_cast<std::size_t>(size) + static_cast<std::size_t>(x);
      if (!sphere.covered[i]) continue;
      for (int c = 0; c < 3; ++c) image.at<cv::Vec3b>(y, x)[2 - c] = cv::saturate_cast<uchar>(255 * srgb_code(sphere.radiance[i][c]));
    }
  return png_bytes(image);
}

std::string base64(const std::string& bytes) {
  static constexpr char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t n = std::min<std::size_t>(3, bytes.size() - i);
    unsigned v = 0;
    for (std::size_t k = 0; k < 3; ++k) v = v << 8 | (k < n ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    for (std::size_t k = 0; k < 4; ++k) out += k <= n ? digits[v >> (18 - 6 * k) & 63] : '=';
  }
  return out;
}

}  // namespace lacquer::tools
