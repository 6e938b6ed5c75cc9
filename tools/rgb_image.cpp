#include "tools/rgb_image.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "libbrdf/color.h"

namespace lacquer::tools {

namespace {

double srgb_code(double linear) {
  const double x = std::clamp(linear, 0.0, 1.0);
  return x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055;
}

glm::dvec3 displayed_lab(const glm::vec3& rgb) { return brdf::lab_from_linear_srgb({std::clamp<double>(rgb.x, 0, 1), std::clamp<double>(rgb.y, 0, 1), std::clamp<double>(rgb.z, 0, 1)}); }

}  // namespace

RgbImage to_image(const brdf::SphereImage& sphere) {
  RgbImage image(sphere.size, sphere.size);
  image.rgb = sphere.radiance;
  image.covered = sphere.covered;
  return image;
}

std::string png_of(const RgbImage& image, int shown_width) {
  cv::Mat picture(image.height, image.width, CV_8UC4, cv::Scalar::all(0));
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      const auto i = static_cast<std::size_t>(y) * static_cast<std::size_t>(image.width) + static_cast<std::size_t>(x);
      if (!image.covered[i]) continue;
      auto& pixel = picture.at<cv::Vec4b>(y, x);
      for (int c = 0; c < 3; ++c) pixel[2 - c] = cv::saturate_cast<uchar>(255 * srgb_code(image.rgb[i][c]));
      pixel[3] = 255;
    }
  if (const int factor = image.width > 0 ? shown_width / image.width : 0; factor > 1)
    cv::resize(picture, picture, {}, factor, factor, cv::INTER_NEAREST);
  std::vector<uchar> png;
  cv::imencode(".png", picture, png);
  return {png.begin(), png.end()};
}

DeltaE delta_e(const RgbImage& a, const RgbImage& b) {
  DeltaE d{a.width, a.height, std::vector<double>(a.rgb.size(), std::numeric_limits<double>::quiet_NaN())};
  std::vector<double> values;
  for (std::size_t i = 0; i < a.rgb.size() && i < b.rgb.size(); ++i) {
    if (!a.covered[i] || !b.covered[i]) continue;
    d.map[i] = brdf::delta_e_2000(displayed_lab(a.rgb[i]), displayed_lab(b.rgb[i]));
    values.push_back(d.map[i]);
  }
  d.n = values.size();
  if (values.empty()) return d;
  for (const double v : values) d.mean += v;
  d.mean /= static_cast<double>(values.size());
  const auto nth = values.begin() + static_cast<std::ptrdiff_t>(std::ceil(0.95 * static_cast<double>(values.size()))) - 1;
  std::nth_element(values.begin(), nth, values.end());
  d.p95 = *nth;
  return d;
}

double exposure_for(const RgbImage& image) {
  std::vector<float> values;
  for (std::size_t i = 0; i < image.rgb.size(); ++i)
    if (image.covered[i]) values.push_back(std::max({image.rgb[i].x, image.rgb[i].y, image.rgb[i].z}));
  if (values.empty()) return 1;
  const auto nth = values.begin() + static_cast<std::ptrdiff_t>(0.99 * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  return *nth > 0 ? 1.0 / static_cast<double>(*nth) : 1;
}

RgbImage exposed(RgbImage image, double factor) {
  for (auto& rgb : image.rgb) rgb *= static_cast<float>(factor);
  return image;
}

}  // namespace lacquer::tools
