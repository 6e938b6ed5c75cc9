#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>

#include "libcalib/highlights.h"
#include "tools/report_page.h"
#include "tools/report_views.h"

namespace lacquer::tools {

namespace {

constexpr double degree = std::numbers::pi / 180;
constexpr std::size_t n_highlight_views = 12;

struct Drawing {
  std::vector<std::vector<double>> lights = std::vector<std::vector<double>>(3), sphere = std::vector<std::vector<double>>(3);  ///< x, y, z in mm
  glm::dvec3 camera{0.0};
  bool distant = false;
};

Drawing drawing_of(const ReportSession& s) {
  const acquire::RigGeometry& g = s.calibration->geometry;
  Drawing d;
  d.camera = 1e3 * (g.cam_from_rig.inverse() * glm::dvec3(0));
  for (const std::size_t v : s.session.views_of(acquire::ViewKind::measurement)) {
    const auto& view = s.session.views[v];
    const auto light = g.place_light(static_cast<std::size_t>(view.light), s.calibration->turntable_scale * view.turntable_angle);
    d.distant = d.distant || light.distant;
    // A distant light has a direction only: drawn on a ring outside of everything else.
    const glm::dvec3 p = light.distant ? light.direction * 4e3 * g.sphere_radius : light.position * 1e3;
    for (int k = 0; k < 3; ++k) d.lights[static_cast<std::size_t>(k)].push_back(p[k]);
  }
  return d;
}

/// To scale in millimetres, seen along the axis that is left out; horizontal rig axis `h`, vertical `v`.
std::string to_scale(const ReportSession& s, const Drawing& d, std::size_t h, std::size_t v, const std::string& id, const std::string& caption) {
  const acquire::RigGeometry& g = s.calibration->geometry;
  static constexpr const char* axes[] = {"x", "y", "z"};
  std::vector<std::vector<double>> circle(2);
  for (int a = 0; a <= 72; ++a) circle[0].push_back(1e3 * g.sphere_radius * std::cos(a * 5 * degree)), circle[1].push_back(1e3 * g.sphere_radius * std::sin(a * 5 * degree));
  const bool pinhole = g.camera.projection == acquire::CameraModel::Projection::pinhole;
  const glm::dvec3 axis_from = 1e3 * (g.axis_point - 2.0 * g.sphere_radius * g.axis_direction), axis_to = 1e3 * (g.axis_point + 2.0 * g.sphere_radius * g.axis_direction);
  std::string script = plot_data("sphere", circle) + plot_data("lights", {d.lights[h], d.lights[v]}) +
                       plot_data("axis", {{axis_from[static_cast<int>(h)], axis_to[static_cast<int>(h)]}, {axis_from[static_cast<int>(v)], axis_to[static_cast<int>(v)]}});
  script += fmt::format("set size ratio -1\nset ytics 200\nset offsets graph 0.05, graph 0.05, graph 0.05, graph 0.05\nset xlabel '{} / mm'\nset ylabel '{} / mm'\nset key outside top horizontal\n", axes[h], axes[v]);
  std::string plot = "plot $sphere using 1:2 with lines lc rgb black title 'sphere', $lights using 1:2 with points pt 7 ps 0.45 lc rgb orange title 'lights, every view'";
  if (v == 1) plot += ", $axis using 1:2 with lines dt 2 lc rgb green title 'turntable axis'";
  if (pinhole) {
    script += plot_data("camera", {{d.camera[static_cast<int>(h)]}, {d.camera[static_cast<int>(v)]}}) +
              plot_data("sight", {{d.camera[static_cast<int>(h)], 0}, {d.camera[static_cast<int>(v)], 0}});
    plot += ", $sight using 1:2 with lines lw 0.8 lc rgb grey, $camera using 1:2 with points pt 5 ps 1.1 lc rgb blue title 'camera'";
  }
  return html_figure(html_plot(script + plot + "\n", {560, 460}, id, caption), caption);
}

struct FoundHighlight {
  std::string view;
  glm::dvec2 found{0.0}, projected{0.0};
  std::string fate;
};

std::vector<FoundHighlight> highlights(const ReportSession& s) {
  std::vector<FoundHighlight> list;
  const calib::Calibration& c = *s.calibration;
  if (c.geometry.camera.projection != acquire::CameraModel::Projection::pinhole) return list;
  for (const std::size_t v : spread_views(s, n_highlight_views)) {
    const auto& view = s.session.views[v];
    const auto light = static_cast<std::size_t>(view.light);
    if (c.geometry.lights[light].distant || !std::filesystem::exists(s.session.radiance_path(view))) continue;
    const auto projected = calib::mirror_pixel(c.geometry, c.geometry.place_light(light, c.turntable_scale * view.turntable_angle).position);
    if (!projected) continue;
    const calib::HighlightResult found =
        calib::find_highlight(calib::read_radiance(s.session.radiance_path(view)), c, light, view.turntable_angle, calib::HighlightOptions{});
    list.push_back({view.id, found.highlight.pixel, *projected, found.fate == calib::HighlightFate::found ? "" : calib::describe(found.fate)});
  }
  return list;
}

std::string highlight_figures(const ReportSession& s) {
  const auto list = highlights(s);
  std::vector<std::vector<double>> columns(4), rest(2);
  std::vector<std::vector<std::string>> rows;
  double sum = 0;
  for (const auto& h : list) {
    const glm::dvec2 off = h.found - h.projected;
    if (!h.fate.empty()) {
      rows.push_back({h.view, fmt::format("{:.2f}", h.projected.x), fmt::format("{:.2f}", h.projected.y), "–", "–", h.fate});
      continue;
    }
    rows.push_back({h.view, fmt::format("{:.2f}", h.projected.x), fmt::format("{:.2f}", h.projected.y), fmt::format("{:+.3f}", off.x), fmt::format("{:+.3f}", off.y), ""});
    const double row[] = {h.projected.x, h.projected.y, off.x, off.y};
    for (std::size_t k = 0; k < 4; ++k) columns[k].push_back(row[k]);
    sum += glm::dot(off, off);
  }
  if (columns[0].empty()) return list.empty() ? "" : html_table("Highlights: none of the views that were tried has one that can be measured", {"view", "projected x", "projected y", "Δx", "Δy", "why"}, rows);
  const double rms = std::sqrt(sum / (2 * static_cast<double>(columns[0].size())));
  const acquire::CameraModel& camera = s.calibration->geometry.camera;
  // Arrows long enough to be seen.
  const double enlarged = std::pow(10, std::floor(std::log10(0.1 * camera.width / std::max(rms, 1e-6))));
  return "<h3>Highlights, projected and found</h3>\n<div class=row>" +
         html_figure(html_plot(plot_data("h", columns) + fmt::format("set size ratio -1\nset xrange [0:{}]\nset yrange [{}:0]\nset xlabel 'x / px'\nset ylabel 'y / px'\n"
                                                                    "plot $h using 1:2:({}*$3):({}*$4) with vectors head filled lc rgb vermilion, $h using 1:2 with points pt 6 ps 0.7 lc rgb blue title 'projected'\n",
                                                                    camera.width, camera.height, enlarged, enlarged),
                               {560, 440}, "highlights-", "Projected highlights with arrows to where they were found"),
                     fmt::format("Arrows: found minus projected, {:g} times enlarged; {:.3f} px RMS per coordinate over {} views.", enlarged, rms, columns[0].size())) +
         "<div>" + html_table("Highlights of views spread over the session, pixels", {"view", "projected x", "projected y", "Δx", "Δy", "not found because"}, rows) + "</div></div>\n";
}

std::string parameters(const calib::Calibration& c) {
  if (c.geometry_uncertainty.parameters.empty()) return "";
  std::vector<std::vector<std::string>> rows;
  for (const auto& p : c.geometry_uncertainty.parameters) {
    const double factor = p.unit == "m" ? 1e3 : p.unit == "rad" ? 1 / degree : 1;
    rows.push_back({p.name, fmt::format("{:.5g}", factor * p.nominal), fmt::format("{:.4f}", factor * p.correction), fmt::format("{:.4f}", factor * p.sigma),
                    fmt::format("{:.3g}", factor * p.prior_sigma), p.unit == "m" ? "mm" : p.unit == "rad" ? "°" : p.unit == "1" ? "" : p.unit});
  }
  return "<details><summary>Estimated geometry, number by number</summary>" + html_table("Corrections of the rig file with their standard errors", {"number", "rig file", "correction", "1 σ", "1 σ before", "unit"}, rows) + "</details>\n";
}

}  // namespace

HtmlSection geometry_section(const ReportSession& s) {
  const Drawing d = drawing_of(s);
  const acquire::RigGeometry& g = s.calibration->geometry;
  std::string html = fmt::format("<p>Geometry: {}. Sphere of {:.3f} mm radius; camera: {}; turntable scale {:.6g}. Scale: {}.</p>\n", html_escaped(s.calibration->geometry_source), 1e3 * g.sphere_radius,
                                 g.camera.projection == acquire::CameraModel::Projection::pinhole ? fmt::format("pinhole, focal length {:.1f} px", g.camera.focal.x) : "distant (orthographic)",
                                 s.calibration->turntable_scale, html_escaped(s.calibration->scale_source));
  const std::string note = d.distant ? " The lights are distant: drawn at four radii." : "";
  html += "<div class=row>" + to_scale(s, d, 2, 0, "top-", "Seen along the turntable's axis (from above), to scale." + note) +
          to_scale(s, d, 2, 1, "side-", "Seen from the side, to scale." + note) + "</div>\n" + highlight_figures(s) + lens_figures(s) + parameters(*s.calibration);
  return {"geometry", "Geometry", html};
}

}  // namespace lacquer::tools
