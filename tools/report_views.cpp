#include "tools/report_views.h"

#include <fmt/format.h>

#include <algorithm>
#include <glm/geometric.hpp>

namespace lacquer::tools {

std::vector<std::size_t> spread_views(const ReportSession& s, std::size_t n) {
  const acquire::RigGeometry& geometry = s.calibration ? s.calibration->geometry : s.session.rig.geometry;
  const double scale = s.calibration ? s.calibration->turntable_scale : 1;
  const glm::dvec3 camera = glm::normalize(geometry.cam_from_rig.inverse() * glm::dvec3(0));
  std::vector<std::size_t> lit, chosen;
  for (const std::size_t i : s.session.views_of(acquire::ViewKind::measurement)) {
    const auto& view = s.session.views[i];
    if (view.light < 0) continue;
    const auto light = geometry.place_light(static_cast<std::size_t>(view.light), scale * view.turntable_angle);
    if (glm::dot(light.distant ? light.direction : glm::normalize(light.position), camera) > -0.35) lit.push_back(i);
  }
  const std::size_t parts = std::min(lit.size(), n);
  for (std::size_t k = 0; k < parts; ++k) chosen.push_back(lit[(2 * k + 1) * lit.size() / (2 * parts)]);
  return chosen;
}

std::string light_name(const ReportSession& s, const acquire::ViewRecord& view) {
  if (view.light < 0) return "no light";
  const std::string& name = s.session.rig.geometry.lights[static_cast<std::size_t>(view.light)].name;
  return name.empty() ? fmt::format("light {}", view.light) : name;
}

glm::dvec3 white_balance(const calib::Calibration& c) {
  const glm::dvec3& light = c.geometry.lights[0].intensity;
  return c.dn_per_radiance / c.dn_per_radiance.y * light / light.y;
}

RgbImage to_picture(const calib::ShownRgb& shown, bool all_covered) {
  RgbImage image(shown.width, shown.height);
  image.rgb = shown.rgb;
  image.covered = shown.complete;
  if (all_covered) image.covered.assign(image.covered.size(), true);
  return image;
}

RgbImage reduced(const RgbImage& image, int factor) {
  RgbImage small(image.width / factor, image.height / factor);
  for (int y = 0; y < small.height; ++y)
    for (int x = 0; x < small.width; ++x) {
      const auto at = [&](int i, int j) { return static_cast<std::size_t>(y * factor + j) * static_cast<std::size_t>(image.width) + static_cast<std::size_t>(x * factor + i); };
      glm::vec3 sum(0.0f);
      bool covered = true;
      for (int j = 0; j < factor; ++j)
        for (int i = 0; i < factor; ++i) sum += image.rgb[at(i, j)], covered = covered && image.covered[at(i, j)];
      const auto k = static_cast<std::size_t>(y) * static_cast<std::size_t>(small.width) + static_cast<std::size_t>(x);
      small.rgb[k] = sum / static_cast<float>(factor * factor);
      small.covered[k] = covered;
    }
  return small;
}

RgbImage cropped(const RgbImage& image, const acquire::PixelRectangle& box) {
  const int x0 = std::clamp(box.x, 0, image.width), y0 = std::clamp(box.y, 0, image.height);
  RgbImage part(std::clamp(box.x + box.width, x0, image.width) - x0, std::clamp(box.y + box.height, y0, image.height) - y0);
  for (int y = 0; y < part.height; ++y)
    for (int x = 0; x < part.width; ++x) {
      const auto from = static_cast<std::size_t>(y0 + y) * static_cast<std::size_t>(image.width) + static_cast<std::size_t>(x0 + x);
      const auto to = static_cast<std::size_t>(y) * static_cast<std::size_t>(part.width) + static_cast<std::size_t>(x);
      part.rgb[to] = image.rgb[from];
      part.covered[to] = image.covered[from];
    }
  return part;
}

}  // namespace lacquer::tools
