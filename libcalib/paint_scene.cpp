#include "libcalib/paint_scene.h"

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>

namespace lacquer::calib {

std::optional<SeenPaint> see(const PaintSphere& sphere, const PaintScene& scene, const glm::dvec3& sight) {
  const double along = glm::dot(sphere.translation, sight);
  const glm::dvec3 nearest = along * sight - sphere.translation;
  const double half_chord2 = sphere.radius * sphere.radius - glm::dot(nearest, nearest);
  if (!(half_chord2 > 0)) return std::nullopt;
  const glm::dvec3 position = sphere.rig_from_cam * (nearest - std::sqrt(half_chord2) * sight), normal = position / sphere.radius;
  const glm::dvec3 wo = -(sphere.rig_from_cam * sight), to_light = scene.light - position;
  const double distance2 = glm::dot(to_light, to_light);
  SeenPaint s;
  s.wi = to_light / std::sqrt(distance2);
  s.cos_i = glm::dot(normal, s.wi);
  s.cos_o = glm::dot(normal, wo);
  const double off_axis = -glm::dot(s.wi, scene.axis);
  if (!(s.cos_i > 0 && s.cos_o > 0 && off_axis > 0)) return std::nullopt;
  s.log_irradiance = std::log(s.cos_i / distance2) + scene.falloff * std::log(off_axis) + scene.log_factor;
  s.coordinates = brdf::half_diff({acquire::to_shading_frame({position, normal, wo}, s.wi).wi, acquire::to_shading_frame({position, normal, wo}, wo).wi});
  return s;
}

std::vector<PaintScene> scenes_of(const acquire::RigGeometry& g, double scale, const std::vector<PaintView>& views) {
  std::vector<PaintScene> scenes;
  for (const PaintView& v : views) {
    const acquire::PlacedLight placed = g.place_light(v.light, scale * v.turntable_angle);
    scenes.push_back({placed.position, placed.axis, placed.falloff_exponent, std::log(v.factor)});
  }
  return scenes;
}

PaintNuisances::PaintNuisances(const acquire::RigGeometry& g, const std::vector<PaintView>& views, const PaintOptions& o) {
  columns.push_back({Column::Kind::vignetting, 0, o.vignetting});
  columns.push_back({Column::Kind::glare, 0, o.glare_sigma});
  if (o.blur_sigma > 0) columns.push_back({Column::Kind::blur, 0, o.blur_sigma});
  bool first = true;
  for (std::size_t i = 0; i < g.lights.size(); ++i) {
    if (std::none_of(views.begin(), views.end(), [&](const PaintView& v) { return v.light == i; })) continue;
    if (!first) columns.push_back({Column::Kind::scale, i, o.light_scale});
    first = false;
    if (!(g.lights[i].falloff_exponent > 0)) continue;
    columns.push_back({Column::Kind::falloff, i, o.falloff * g.lights[i].falloff_exponent});
    columns.push_back({Column::Kind::aim_a, i, o.aim_rad});
    columns.push_back({Column::Kind::aim_b, i, o.aim_rad});
  }
}

double PaintNuisances::derivative(const Column& c, const PaintSample& sample, const PaintView& view, const PaintScene& scene, const SeenPaint& seen) const {
  if (c.kind == Column::Kind::vignetting) return -sample.corner2;
  if (c.light != view.light) return 0;
  const double off_axis = -glm::dot(seen.wi, scene.axis);
  if (c.kind == Column::Kind::scale) return 1;
  if (c.kind == Column::Kind::falloff) return std::log(off_axis);
  // The aim is rigid on the arm: in axes that turn with it, one along the arm's plane as far as the camera's x tells.
  const glm::dvec3 a = glm::normalize(glm::cross(std::abs(scene.axis.y) < 0.9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0), scene.axis)), b = glm::cross(scene.axis, a);
  return scene.falloff * -glm::dot(seen.wi, c.kind == Column::Kind::aim_a ? a : b) / off_axis;
}

}  // namespace lacquer::calib
