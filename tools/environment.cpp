#include "tools/environment.h"

#include <ImfArray.h>
#include <ImfRgbaFile.h>
#include <fmt/format.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <glm/geometric.hpp>
#include <glm/vec2.hpp>
#include <numbers>

#include "libbrdf/error.h"
#include "libbrdf/metrics.h"
#include "libbrdf/shading_frame.h"

namespace lacquer::tools {

namespace {

constexpr double pi = std::numbers::pi;
constexpr double widths[] = {0.02, 0.12, 0.4};  ///< RMS slopes of the half vectors that are sampled
constexpr double probe_share = 0.4, width_share = 0.2;

double brightness(const glm::vec3& rgb) { return std::max(0.0, 0.2126 * rgb.x + 0.7152 * rgb.y + 0.0722 * rgb.z); }

/// Radical inverse of base 2 (van der Corput).
double van_der_corput(std::uint32_t i) {
  i = (i << 16) | (i >> 16);
  i = ((i & 0x00ff00ffu) << 8) | ((i & 0xff00ff00u) >> 8);
  i = ((i & 0x0f0f0f0fu) << 4) | ((i & 0xf0f0f0f0u) >> 4);
  i = ((i & 0x33333333u) << 2) | ((i & 0xccccccccu) >> 2);
  i = ((i & 0x55555555u) << 1) | ((i & 0xaaaaaaaau) >> 1);
  return i * 0x1p-32;
}

/// Two numbers in [0, 1) that depend on the pixel alone.
glm::dvec2 shift_of(std::uint32_t pixel) {
  const auto mixed = [](std::uint32_t x) {  // Wellons' lowbias32
    x = (x ^ (x >> 16)) * 0x7feb352dU;
    x = (x ^ (x >> 15)) * 0x846ca68bU;
    return (x ^ (x >> 16)) * 0x1p-32;
  };
  return {mixed(2 * pixel + 1), mixed(2 * pixel + 2)};
}

/// Beckmann distribution of half vectors as a density over solid angle, including cos(theta_h).
double half_vector_pdf(double cosine, double m) {
  if (!(cosine > 0)) return 0;
  const double c2 = cosine * cosine;
  return std::exp(-(1 - c2) / (c2 * m * m)) / (pi * m * m * c2 * cosine);
}

struct PixelLight {
  glm::dvec3 reflected{0.0}, from_fallback{0.0};
  bool complete = true;
};

PixelLight reflected(const brdf::Brdf& brdf, const Environment& environment, const glm::dvec3& normal, const brdf::Brdf* fallback, int n, std::uint32_t pixel) {
  const brdf::ShadingFrame frame(normal);
  const glm::dvec3 wo = frame.to_local({0, 0, 1});
  const glm::dvec2 shift = shift_of(pixel);
  PixelLight light;
  for (int i = 0; i < n; ++i) {
    const double u = std::fmod((i + 0.5) / n + shift.x, 1.0), v = std::fmod(van_der_corput(static_cast<std::uint32_t>(i)) + shift.y, 1.0);
    glm::dvec3 wi;
    if (u < probe_share) {
      wi = frame.to_local(environment.sample(u / probe_share, v));
    } else {
      const double scaled = (u - probe_share) / width_share;
      const int k = std::min(2, static_cast<int>(scaled));
      const double slope = widths[k] * std::sqrt(-std::log1p(-std::min(scaled - k, 1 - 1e-12))), phi = 2 * pi * v;
      const glm::dvec3 h = glm::normalize(glm::dvec3(slope * std::cos(phi), slope * std::sin(phi), 1));
      wi = 2 * glm::dot(wo, h) * h - wo;
    }
    if (!(wi.z > 0)) continue;
    const glm::dvec3 h = glm::normalize(wi + wo), world = frame.to_world(wi);
    double pdf = probe_share * environment.pdf(world);
    for (const double m : widths) pdf += width_share * half_vector_pdf(h.z, m) / (4 * glm::dot(wo, h));
    if (!(pdf > 0)) continue;
    const glm::dvec3 weight = environment.radiance(world) * (wi.z / (pdf * n));
    auto value = brdf.value({wi, wo});
    if (!value && fallback) {
      value = fallback->value({wi, wo});
      if (value) light.from_fallback += *value * weight;
    }
    if (value)
      light.reflected += *value * weight;
    else
      light.complete = false;
  }
  return light;
}

}  // namespace

Environment::Environment(const std::filesystem::path& file) {
  try {
    Imf::RgbaInputFile in(file.c_str());
    const auto window = in.dataWindow();
    const std::int64_t width = std::int64_t{window.max.x} - window.min.x + 1, height = std::int64_t{window.max.y} - window.min.y + 1;
    if (width < 2 || height < 2 || width > 4096 || height > 2048)
      throw Error(ErrorCode::file, fmt::format("{}: expected a light probe of 2 x 2 to 4096 x 2048 pixels, got {} x {}", file.string(), width, height));
    width_ = static_cast<int>(width);
    height_ = static_cast<int>(height);
    std::vector<Imf::Rgba> pixels(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
    in.setFrameBuffer(pixels.data() - window.min.x - static_cast<std::ptrdiff_t>(window.min.y) * width, 1, static_cast<std::size_t>(width));
    in.readPixels(window.min.y, window.max.y);
    for (const auto& p : pixels) radiance_.emplace_back(static_cast<float>(p.r), static_cast<float>(p.g), static_cast<float>(p.b));
  } catch (const Error&) {
    throw;
  } catch (const std::exception& e) {
    throw Error(ErrorCode::file, fmt::format("{}: expected a light probe (OpenEXR, RGB): {}", file.string(), e.what()));
  }
  columns_.resize(radiance_.size());
  for (int y = 0; y < height_; ++y) {
    double sum = 0;
    for (int x = 0; x < width_; ++x) {
      const glm::vec3& rgb = radiance_[texel(x, y)];
      if (!std::isfinite(rgb.x + rgb.y + rgb.z)) throw Error(ErrorCode::file, fmt::format("{}: pixel ({}, {}): expected finite numbers", file.string(), x, y));
      columns_[texel(x, y)] = sum += brightness(rgb) * std::sin(pi * (y + 0.5) / height_);
    }
    rows_.push_back((rows_.empty() ? 0 : rows_.back()) + sum);
  }
  if (!(rows_.back() > 0)) throw Error(ErrorCode::file, fmt::format("{}: expected a light probe that is not black", file.string()));
}

glm::dvec3 Environment::radiance(const glm::dvec3& w) const {
  const double x = (std::atan2(w.x, -w.z) / (2 * pi) + 0.5) * width_ - 0.5, y = std::acos(std::clamp(w.y, -1.0, 1.0)) / pi * height_ - 0.5;
  const int x0 = static_cast<int>(std::floor(x)), y0 = static_cast<int>(std::floor(y));
  glm::dvec3 sum(0.0);
  for (int j = 0; j < 2; ++j)
    for (int i = 0; i < 2; ++i)
      sum += glm::dvec3(radiance_[texel((x0 + i + width_) % width_, std::clamp(y0 + j, 0, height_ - 1))]) * ((i ? x - x0 : 1 - x + x0) * (j ? y - y0 : 1 - y + y0));
  return sum;
}

glm::dvec3 Environment::sample(double u, double v) const {
  const double target = u * rows_.back();
  const auto row = std::min(std::upper_bound(rows_.begin(), rows_.end(), target), rows_.end() - 1);
  const int y = static_cast<int>(row - rows_.begin());
  const double before = y == 0 ? 0 : rows_[static_cast<std::size_t>(y) - 1], in_row = *row - before;
  const double dy = in_row > 0 ? (target - before) / in_row : 0.5;
  const auto begin = columns_.begin() + static_cast<std::ptrdiff_t>(texel(0, y)), end = begin + width_;
  const auto column = std::min(std::upper_bound(begin, end, v * *(end - 1)), end - 1);
  const double left = column == begin ? 0 : *(column - 1), in_column = *column - left;
  const double dx = in_column > 0 ? (v * *(end - 1) - left) / in_column : 0.5;
  const double theta = pi * (y + dy) / height_, phi = 2 * pi * ((static_cast<double>(column - begin) + dx) / width_ - 0.5);
  return {std::sin(theta) * std::sin(phi), std::cos(theta), -std::sin(theta) * std::cos(phi)};
}

double Environment::pdf(const glm::dvec3& w) const {
  const double sine = std::hypot(w.x, w.z);
  if (!(sine > 0)) return 0;
  const int x = std::clamp(static_cast<int>((std::atan2(w.x, -w.z) / (2 * pi) + 0.5) * width_), 0, width_ - 1);
  const int y = std::clamp(static_cast<int>(std::acos(std::clamp(w.y, -1.0, 1.0)) / pi * height_), 0, height_ - 1);
  const double probability = brightness(radiance_[texel(x, y)]) * std::sin(pi * (y + 0.5) / height_) / rows_.back();
  return probability * width_ * height_ / (2 * pi * pi * sine);
}

std::optional<std::filesystem::path> default_probe() {
  std::error_code none;
  const std::filesystem::path executable = std::filesystem::read_symlink("/proc/self/exe", none);
  for (const std::filesystem::path& file : {executable.parent_path().parent_path() / "share" / "lacquer" / "studio.exr",
                                            std::filesystem::path(LACQUER_SOURCE_DIR) / "data-samples" / "environments" / "studio.exr"})
    if (std::filesystem::exists(file, none)) return file;
  return std::nullopt;
}

ProbeSphere render_probe_sphere(const brdf::Brdf& brdf, const Environment& environment, int size, const brdf::Brdf* fallback, int samples_per_pixel) {
  ProbeSphere sphere{RgbImage(size, size)};
  const std::size_t n = sphere.image.rgb.size();
  std::vector<unsigned char> covered(n, 0);
  std::vector<glm::dvec2> sums(n, glm::dvec2(0.0));  // from the fallback, in all
  tbb::parallel_for(tbb::blocked_range<int>(0, size), [&](const tbb::blocked_range<int>& rows) {
    for (int y = rows.begin(); y != rows.end(); ++y)
      for (int x = 0; x < size; ++x) {
        const auto normal = brdf::sphere_normal(size, x, y);
        if (!normal) continue;
        const std::size_t i = static_cast<std::size_t>(y) * static_cast<std::size_t>(size) + static_cast<std::size_t>(x);
        const PixelLight light = reflected(brdf, environment, *normal, fallback, samples_per_pixel, static_cast<std::uint32_t>(i));
        if (!light.complete) continue;
        covered[i] = 1;
        sphere.image.rgb[i] = glm::vec3(light.reflected);
        sums[i] = {light.from_fallback.y, light.reflected.y};
      }
  });
  glm::dvec2 sum(0.0);
  for (const auto& s : sums) sum += s;
  if (sum.y > 0) sphere.fallback_share = sum.x / sum.y;
  sphere.image.covered.assign(covered.begin(), covered.end());
  return sphere;
}

}  // namespace lacquer::tools
