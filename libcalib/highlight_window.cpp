#include "libcalib/highlight_window.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>

#include "libcalib/geometry_projection.h"
#include "libcalib/samples.h"

namespace lacquer::calib {

namespace {

struct Place {
  acquire::SurfacePoint point;
  glm::dvec3 wi;
  glm::dvec2 slope;
  double falloff;  ///< irradiance on a surface that faces the light, relative
};

std::optional<Place> place_at(const acquire::RigGeometry& rig, const acquire::PlacedLight& light, const glm::dvec3& u, const glm::dvec3& v,
                              const glm::dvec2& pixel) {
  const auto point = acquire::trace(rig, pixel);
  if (!point) return std::nullopt;
  const auto lit = acquire::illuminate(light, *point);
  if (!lit) return std::nullopt;
  const double cosine = glm::dot(point->normal, lit->wi);
  const glm::dvec3 h = glm::normalize(lit->wi + point->wo), s = h / glm::dot(h, point->normal) - point->normal;
  return Place{*point, lit->wi, {glm::dot(s, u), glm::dot(s, v)}, lit->irradiance[1] / (light.intensity[1] * cosine)};
}

/// The emitter turns wi alone: the half vector by half of that in the plane of wi and wo, by 1/(2 cos theta_d) across.
glm::dmat2 emitter_covariance(const acquire::PlacedLight& light, const acquire::SurfacePoint& point, const glm::dvec3& u, const glm::dvec3& v) {
  if (light.distant) return glm::dmat2(0.0);
  const glm::dvec3 to_light = light.position - point.position;
  const double in_plane = light.diameter * light.diameter / (64 * glm::dot(to_light, to_light)), cosine = glm::dot(point.normal, point.wo);
  const double off_plane = in_plane / (cosine * cosine);
  glm::dvec2 along(glm::dot(point.wo, u), glm::dot(point.wo, v));
  along = glm::length(along) > 1e-9 ? glm::normalize(along) : glm::dvec2(1, 0);
  return glm::dmat2(off_plane) + (in_plane - off_plane) * glm::outerProduct(along, along);
}

}  // namespace

std::optional<ExpectedHighlight> expect_highlight(const acquire::RigGeometry& rig, const acquire::PlacedLight& light) {
  ExpectedHighlight e;
  e.light = light;
  // A distant light is one so far away that parallax is beyond rounding.
  const auto pixel = mirror_pixel(rig, light.distant ? 1e7 * rig.sphere_radius * light.direction : light.position);
  if (!pixel) return std::nullopt;
  const auto point = acquire::trace(rig, *pixel);
  if (!point) return std::nullopt;
  e.pixel = *pixel;
  e.point = *point;
  e.u = glm::normalize(glm::cross(std::abs(point->normal.y) < 0.9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0), point->normal));
  e.v = glm::cross(point->normal, e.u);
  for (int axis = 0; axis < 2; ++axis) {
    const glm::dvec2 half_step(axis == 0 ? 0.5 : 0.0, axis == 0 ? 0.0 : 0.5);
    const auto before = place_at(rig, light, e.u, e.v, *pixel - half_step), after = place_at(rig, light, e.u, e.v, *pixel + half_step);
    if (!before || !after) return std::nullopt;
    e.slope_per_pixel[axis] = after->slope - before->slope;
  }
  e.emitter = emitter_covariance(light, *point, e.u, e.v);
  return e;
}

HighlightWindow collect_window(const RadianceImage& image, const glm::ivec2& corner, const Calibration& calibration, const ExpectedHighlight& expected,
                               const glm::dvec2& about, double radius_px, double min_cosine) {
  const acquire::RigGeometry& rig = calibration.geometry;
  HighlightWindow window;
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(image.layout));
  const int x0 = static_cast<int>(std::floor(about.x - radius_px)), x1 = static_cast<int>(std::ceil(about.x + radius_px));
  const int y0 = static_cast<int>(std::floor(about.y - radius_px)), y1 = static_cast<int>(std::ceil(about.y + radius_px));
  for (int y = y0; y <= y1; ++y)
    for (int x = x0; x <= x1; ++x) {
      const glm::dvec2 pixel(x, y);
      if (glm::length(pixel - about) > radius_px) continue;
      const int column = x - corner.x, row = y - corner.y;
      if (column < 0 || row < 0 || column >= image.width || row >= image.height) {
        window.cut_by_border = true;
        continue;
      }
      const auto place = place_at(rig, expected.light, expected.u, expected.v, pixel);
      if (!place || glm::dot(place->point.normal, place->point.wo) < min_cosine) continue;
      const double to_camera = glm::dot(place->point.normal, place->point.wo), to_light = glm::dot(place->point.normal, place->wi);
      const double seen = place->falloff * lens_transmission(calibration, pixel);
      const std::size_t first = (static_cast<std::size_t>(row) * static_cast<std::size_t>(image.width) + static_cast<std::size_t>(column)) * per_pixel;
      for (std::size_t k = 0; k < per_pixel; ++k)
        window.values.push_back({pixel, place->slope, image.radiance[first + k], image.variance[first + k], seen * to_light, seen / to_camera,
                                 static_cast<std::size_t>(acquire::channel_of(image.layout, x, y, static_cast<int>(k))), image.flags[first + k]});
    }
  return window;
}

PeakMap::PeakMap(const std::vector<HighlightValue>& values) {
  if (values.empty()) return;
  glm::dvec2 low = values.front().pixel, high = low;
  std::array<double, 3> scale{}, n{};
  for (const HighlightValue& v : values) {
    low = glm::min(low, v.pixel);
    high = glm::max(high, v.pixel);
    if (v.flag == PixelFlag::invalid) continue;
    scale[v.channel] += std::max(0.0, v.radiance / v.mirror);
    n[v.channel] += 1;
  }
  double largest = 0;
  for (std::size_t c = 0; c < 3; ++c) largest = std::max(largest, scale[c] /= std::max(1.0, n[c]));
  if (!(largest > 0)) return;
  // A channel that saw next to nothing must not be blown up.
  for (double& s : scale) s = std::max(s, 0.1 * largest);
  corner_ = glm::ivec2(low);
  width_ = static_cast<int>(high.x - low.x) + 1;
  height_ = static_cast<int>(high.y - low.y) + 1;
  std::vector<float> sum(index(0, height_)), count(sum.size());
  for (const HighlightValue& v : values) {
    if (v.flag == PixelFlag::invalid) continue;
    const std::size_t i = index(static_cast<int>(v.pixel.x) - corner_.x, static_cast<int>(v.pixel.y) - corner_.y);
    sum[i] += static_cast<float>(v.radiance / v.mirror / scale[v.channel]);
    count[i] += 1;
  }
  mean_.assign(sum.size(), std::nanf(""));
  std::vector<float> sorted;
  for (int y = 1; y + 1 < height_; ++y)
    for (int x = 1; x + 1 < width_; ++x) {
      float s = 0, k = 0;
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx) {
          s += sum[index(x + dx, y + dy)];
          k += count[index(x + dx, y + dy)];
        }
      if (k < 5) continue;
      mean_[index(x, y)] = s / k;
      sorted.push_back(s / k);
    }
  if (sorted.empty()) return;
  std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2), sorted.end());
  level_ = static_cast<double>(sorted[sorted.size() / 2]);
}

std::optional<PeakMap::Peak> PeakMap::brightest(const glm::dvec2& from, double distance) const {
  std::optional<Peak> best;
  for (int y = 0; y < height_; ++y)
    for (int x = 0; x < width_; ++x) {
      const float value = mean_[index(x, y)];
      if (std::isnan(value) || (best && static_cast<double>(value) <= best->height)) continue;
      const glm::dvec2 pixel = glm::dvec2(corner_ + glm::ivec2(x, y));
      if (glm::length(pixel - from) >= distance) best = Peak{pixel, static_cast<double>(value)};
    }
  return best;
}

std::size_t PeakMap::area_above_half(const Peak& peak) const {
  const auto half = static_cast<float>(0.5 * (peak.height + level_));
  std::vector<bool> seen(mean_.size());
  std::vector<glm::ivec2> open{glm::ivec2(peak.pixel) - corner_};
  seen[index(open[0].x, open[0].y)] = true;
  std::size_t area = 0;
  while (!open.empty()) {
    const glm::ivec2 at = open.back();
    open.pop_back();
    ++area;
    for (const glm::ivec2 step : {glm::ivec2(1, 0), glm::ivec2(-1, 0), glm::ivec2(0, 1), glm::ivec2(0, -1)}) {
      const glm::ivec2 next = at + step;
      if (next.x < 0 || next.y < 0 || next.x >= width_ || next.y >= height_) continue;
      const std::size_t i = index(next.x, next.y);
      if (seen[i] || !(mean_[i] > half)) continue;
      seen[i] = true;
      open.push_back(next);
    }
  }
  return area;
}

}  // namespace lacquer::calib
