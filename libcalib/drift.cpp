#include "libcalib/drift.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "libbrdf/error.h"
#include "libcalib/drift_fit.h"

namespace lacquer::calib {

namespace {

constexpr double min_signal_to_noise = 20;
constexpr double bounded_sigmas = 3;
constexpr int max_iterations = 50;

[[noreturn]] void fail(const std::string& what) { throw Error(ErrorCode::input, "light drift: " + what); }

bool usable(const RadianceImage& image, std::size_t i) { return image.flags[i] == PixelFlag::valid && image.variance[i] > 0; }

PixelRectangle checked(const RadianceImage& image, const std::optional<PixelRectangle>& patch) {
  const PixelRectangle p = patch.value_or(PixelRectangle{0, 0, image.width, image.height});
  if (p.x < 0 || p.y < 0 || p.width < 1 || p.height < 1 || p.x > image.width - p.width || p.y > image.height - p.height)
    fail(fmt::format("reference patch: expected pixels inside {} x {}, got {} x {} at ({}, {})", image.width, image.height, p.width, p.height,
                     p.x, p.y));
  return p;
}

}  // namespace

IntensityComparison::IntensityComparison(const RadianceImage& first, double time_s, std::optional<PixelRectangle> patch)
    : width_(first.width), height_(first.height), layout_(first.layout) {
  const PixelRectangle p = checked(first, patch);
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(first.layout));
  double sum = 0, variance = 0;
  for (int y = p.y; y < p.y + p.height; ++y) {
    const std::size_t row = (static_cast<std::size_t>(y) * static_cast<std::size_t>(first.width) + static_cast<std::size_t>(p.x)) * per_pixel;
    for (std::size_t i = row; i < row + static_cast<std::size_t>(p.width) * per_pixel; ++i) {
      const double x = first.radiance[i], v = first.variance[i];
      if (!usable(first, i) || !(x > min_signal_to_noise * std::sqrt(v))) continue;
      values_.push_back({i, first.radiance[i], first.variance[i]});
      sum += x;
      variance += v;
    }
  }
  if (values_.empty()) fail("no value of the first reference image is valid and twenty times brighter than its noise");
  first_point_ = {time_s, 1, std::sqrt(variance) / sum};
}

DriftPoint IntensityComparison::compare(const RadianceImage& image, double time_s) const {
  if (image.width != width_ || image.height != height_ || image.layout != layout_)
    fail(fmt::format("expected {} x {} {} as the first reference image, got {} x {} {}", width_, height_, name_of(layout_),
                     image.width, image.height, name_of(image.layout)));
  DriftPoint point{time_s, 1, 0};
  double relative_change = 1;
  for (int iteration = 0; iteration < max_iterations && std::abs(relative_change) > 1e-9; ++iteration) {
    // sum_i h_i (x_i - f x0_i) = 0 with h_i = min(1, (3 sigma / difference)^4): what contradicts the others counts for nothing.
    double numerator = 0, denominator = 0, noise = 0, square = 0;
    std::size_t n = 0;
    for (const Value& first : values_) {
      const std::size_t i = first.index;
      if (!usable(image, i)) continue;
      const double x0 = first.radiance, x = image.radiance[i], v = image.variance[i];
      const double sigma = std::sqrt(v + point.intensity * point.intensity * first.variance);
      const double difference = std::abs(x - point.intensity * x0) / sigma, bound = bounded_sigmas / difference;
      // Everything is within bounds at the first look, when the intensity is not known yet.
      const double h = iteration == 0 || bound >= 1 ? 1 : std::pow(bound, 4);
      numerator += h * x;
      denominator += h * x0;
      noise += h * h * v;
      square += h * h * difference * difference;
      ++n;
    }
    if (n == 0 || !(numerator > 0)) fail("a reference image shares no usable value with the first one");
    const double intensity = numerator / denominator;
    relative_change = intensity / point.intensity - 1;
    point.intensity = intensity;
    point.sigma = std::sqrt(noise * std::max(square / static_cast<double>(n), 1.0)) / denominator;
  }
  return point;
}

double LightDrift::factor(double time_s) const { return evaluate_drift(*this, time_s).factor; }
double LightDrift::factor_sigma(double time_s) const { return evaluate_drift(*this, time_s).sigma; }

namespace {
constexpr std::array<const char*, 5> model_names{"none", "linear", "warm_up", "smooth", "per_view"};
}

std::string name_of(LightDrift::Model model) { return model_names[static_cast<std::size_t>(model)]; }

LightDrift::Model drift_model_from_name(const std::string& name) {
  const auto found = std::find(model_names.begin(), model_names.end(), name);
  if (found == model_names.end()) fail(fmt::format("model: expected none, linear, warm_up, smooth or per_view, got \"{}\"", name));
  return static_cast<LightDrift::Model>(found - model_names.begin());
}

}  // namespace lacquer::calib
