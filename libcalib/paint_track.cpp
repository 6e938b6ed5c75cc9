#include "libcalib/paint_track.h"

#include <cmath>
#include <glm/geometric.hpp>

#include "libcalib/geometry_residuals.h"

namespace lacquer::calib {

std::optional<PaintTrack> paint_track(std::size_t view, const Highlight& h, double noise_factor, const GeometryUnknowns& unknowns, const std::vector<double>& x) {
  constexpr double turn = 1e-5, step = 1e-3;
  const acquire::RigGeometry g = unknowns.geometry(x);
  const double scale = unknowns.turntable_scale(x);
  Highlight ahead = h, behind = h;
  ahead.turntable_angle += turn;
  behind.turntable_angle -= turn;
  const glm::dvec2 miss = GeometryResiduals::miss(g, scale, h);
  const glm::dvec2 track = (GeometryResiduals::miss(g, scale, behind) - GeometryResiduals::miss(g, scale, ahead)) / (2 * turn);  // pixels per radian
  const double speed2 = glm::dot(track, track);
  if (!g.lights[h.light].on_arm || !(speed2 > 0) || !std::isfinite(speed2)) return std::nullopt;
  PaintTrack t;
  t.view = view;
  t.angle = glm::dot(miss, track) / speed2;
  t.sigma = noise_factor * std::sqrt(track.x * track.x * h.xx + 2 * track.x * track.y * h.xy + track.y * track.y * h.yy) / speed2;
  for (std::size_t k = 0; k < unknowns.size(); ++k) {
    std::vector<double> up = x, down = x;
    up[k] += step;
    down[k] -= step;
    const glm::dvec2 moved = GeometryResiduals::miss(unknowns.with_visible_moved(x, k, -step), unknowns.turntable_scale(down), h) -
                             GeometryResiduals::miss(unknowns.with_visible_moved(x, k, step), unknowns.turntable_scale(up), h);
    t.by.push_back(glm::dot(moved, track) / (2 * step * speed2));
  }
  return t;
}

}  // namespace lacquer::calib
