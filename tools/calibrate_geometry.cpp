#include "tools/calibrate_geometry.h"

#include <fmt/format.h>

#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>

#include "libacquire/session.h"
#include "libacquire/sim/simulated_world.h"
#include "libcalib/calibration.h"
#include "libcalib/distant_lights.h"
#include "libcalib/geometry_difference.h"
#include "libcalib/geometry_session.h"
#include "libcalib/merge_session.h"
#include "tools/calibrate_parts.h"
#include "tools/fit_table.h"
#include "tools/json_output.h"

namespace lacquer::tools {

namespace {

constexpr double degree = 3.14159265358979323846 / 180;

struct Options {
  std::string session;
  bool from_rig = false, without_paint = false;
};

/// Factor and unit for people.
std::pair<double, const char*> shown_as(const std::string& unit) {
  if (unit == "m") return {1e3, "mm"};
  if (unit == "rad") return {1 / degree, "deg"};
  if (unit == "px") return {1, "px"};
  return {1, ""};
}

std::string names(const std::vector<std::string>& views) {
  std::string text;
  for (std::size_t i = 0; i < views.size() && i < 12; ++i) text += (i ? " " : "") + views[i];
  return views.size() > 12 ? text + fmt::format(" and {} more", views.size() - 12) : text;
}

/// Of a simulated rig, at the angles read back.
calib::GeometryDifference difference_from_truth(const acquire::RigGeometry& geometry, double scale, const calib::GeometryUncertainty& uncertainty, const acquire::Session& session) {
  const acquire::RigGeometry truth = acquire::sim::true_geometry(session.rig);
  std::vector<calib::ViewAngles> views;
  for (const std::size_t v : session.views_of(acquire::ViewKind::measurement)) {
    const acquire::ViewRecord& view = session.views[v];
    views.push_back({static_cast<std::size_t>(view.light), scale * view.turntable_angle + uncertainty.angle_correction(view.id), view.turntable_angle});
  }
  return calib::geometry_difference(geometry, truth, views);
}

void print_difference(const char* name, const calib::GeometryDifference& d) {
  fmt::print("  {:<10} half vector {:8.4f} deg   light {:8.4f} deg   distance {:6.3f} %   sphere centre {:7.3f} px\n", name, d.half_vector_rad / degree,
             d.light_rad / degree, 100 * d.distance, d.centre_px);
}

void print_distant_lights(const calib::DistantLights& d) {
  fmt::print("silhouette: {} of {} arcs, rms {:.3f} px: centre {:.2f} {:.2f} px, radius {:.2f} px\n", d.sphere.n_edges, d.n_arcs, d.sphere.edge_rms_px, d.centre_px.x,
             d.centre_px.y, d.radius_px);
  std::map<calib::HighlightFate, std::vector<std::string>> rejected;
  std::size_t n_found = 0;
  for (const calib::DistantLight& light : d.lights) {
    if (light.fate == calib::HighlightFate::found) ++n_found;
    else rejected[light.fate].push_back(light.view);
  }
  fmt::print("highlights: {} of {} views; directions against the rig file's: {:.2f} deg median, {:.2f} deg largest\n", n_found, d.lights.size(), d.median_off_rad / degree,
             d.largest_off_rad / degree);
  for (const auto& [fate, views] : rejected) fmt::print("  no highlight in {}: {}\n", names(views), describe(fate));
  if (!d.joint.solved) return;
  const calib::JointDirections& j = d.joint;
  fmt::print("jointly: directions {:.2f} deg off (median) after\n", j.median_off_rad / degree);
  const auto row = [](const char* name, double value, double sigma, const char* unit) { fmt::print("  {:<38}{} {}\n", name, with_error_aligned(value, sigma, 9, 10), unit); };
  for (int k = 0; k < 3; ++k) row(fmt::format("turn of all given directions about {}", "xyz"[k]).c_str(), j.turn[k] / degree, j.turn_sigma[k] / degree, "deg");
  for (int k = 0; k < 2; ++k) row(fmt::format("shift of the outline along {}", "xy"[k]).c_str(), j.shift_px[k], j.shift_sigma_px[k], "px");
  row("change of its radius", j.radius_px, j.radius_sigma_px, "px");
}

nlohmann::ordered_json distant_lights_json(const calib::DistantLights& d) {
  using Json = nlohmann::ordered_json;
  Json j{{"silhouette", {{"arcs", d.n_arcs}, {"used", d.sphere.n_edges}, {"rms_px", d.sphere.edge_rms_px}, {"centre_px", {d.centre_px.x, d.centre_px.y}}, {"radius_px", d.radius_px}}},
         {"lights", Json::array()}, {"median_off_rad", d.median_off_rad}, {"largest_off_rad", d.largest_off_rad}};
  for (const calib::DistantLight& light : d.lights) {
    Json l{{"view", light.view}, {"fate", describe(light.fate)}};
    if (light.fate == calib::HighlightFate::found)
      l.update({{"direction", {light.direction.x, light.direction.y, light.direction.z}}, {"sigma_rad", light.sigma_rad}, {"off_rad", light.off_rad}});
    j["lights"].push_back(std::move(l));
  }
  if (d.joint.solved)
    j["joint"] = {{"turn_rad", {d.joint.turn.x, d.joint.turn.y, d.joint.turn.z}}, {"turn_sigma_rad", {d.joint.turn_sigma.x, d.joint.turn_sigma.y, d.joint.turn_sigma.z}},
                  {"shift_px", {d.joint.shift_px.x, d.joint.shift_px.y}}, {"shift_sigma_px", {d.joint.shift_sigma_px.x, d.joint.shift_sigma_px.y}},
                  {"radius_px", d.joint.radius_px}, {"radius_sigma_px", d.joint.radius_sigma_px},
                  {"median_off_rad", d.joint.median_off_rad}};
  return j;
}

}  // namespace

void print_geometry(const calib::SessionGeometry& g, const acquire::Session& session) {
  const calib::GeometryEstimate& e = g.estimate;
  const bool paint = g.paint.n_samples > 0;
  fmt::print("{:<18} {:>4} {:>11} {:>12} ± {:<10} {:>14}{}\n", "unknown", "unit", "rig file", "estimate", "sigma", "off rig file", paint ? "   moved by paint" : "");
  for (const calib::GeometryParameter& p : e.uncertainty.parameters) {
    const auto [factor, unit] = shown_as(p.unit);
    fmt::print("{:<18} {:>4} {:>11.6g} {} {:>+8.1f} priors{}\n", p.name, unit, factor * p.nominal, with_error_aligned(factor * (p.nominal + p.correction), factor * p.sigma, 12, 13),
               p.correction / p.prior_sigma, paint ? fmt::format("   {:>+8.1f} sigma", p.paint_shift) : "");
  }
  fmt::print("silhouette: {} of {} arcs ({} never lit, {} outliers), rms {:.3f} px, {:.1f} times the sigma of their fits; lens blur {:.2f} px\n", e.n_edges, g.n_arcs,
             g.n_dark_arcs, e.n_edge_outliers, e.edge_rms_px, e.edge_noise_factor, g.lens_blur_px);
  fmt::print("highlights: {} of {} views, rms {:.3f} px per coordinate, across their track {:.1f} times the sigma of their fits; turntable: angles scatter by {:.3f} deg\n",
             e.n_highlights, g.n_views, e.highlight_rms_px, e.highlight_noise_factor, e.angle_sigma_rad / degree);
  for (const auto& [fate, views] : g.rejected) fmt::print("  no highlight in {}: {}\n", names(views), describe(fate));
  for (const auto& o : e.outliers) fmt::print("  outlier: {}: off by {:+.2f} {:+.2f} px, left out\n", o.view, o.residual.x, o.residual.y);
  fmt::print("known to (1 sigma): half vectors {:.2g} deg, lights {:.2g} deg and {:.2g} % of their distance, sphere centre {:.2g} px{}\n", e.half_vector_sigma_rad / degree,
             e.light_sigma_rad / degree, 100 * e.distance_sigma, e.centre_sigma_px, e.converged ? "" : "; the solver did NOT converge");
  if (paint)
    fmt::print("light on the paint: {} samples, {:.2f} % about a smooth paint besides their noise; silhouette and highlights alone: half vectors {:.2g} deg, distance {:.2g} %\n",
               g.paint.n_samples, 100 * g.paint.scatter, g.paint.half_vector_sigma_before / degree, 100 * g.paint.distance_sigma_before);
  for (const std::string& w : e.warnings) fmt::print("{} {}\n", emphasised("warning:", Emphasis::warning, stdout), w);
  if (session.rig.kind != acquire::RigDescription::Kind::simulated) return;
  // The truth of a simulated rig enters here, for the comparison, and nowhere before.
  fmt::print("against the simulated truth, at the angles read back:\n");
  print_difference("rig file", difference_from_truth(session.rig.geometry, 1, {}, session));
  print_difference("estimate", difference_from_truth(e.geometry, e.turntable_scale, e.uncertainty, session));
}

nlohmann::ordered_json geometry_json(const calib::SessionGeometry& g, const acquire::Session& session) {
  using Json = nlohmann::ordered_json;
  const calib::GeometryEstimate& e = g.estimate;
  Json j{{"parameters", Json::array()}};
  for (const calib::GeometryParameter& p : e.uncertainty.parameters)
    j["parameters"].push_back({{"name", p.name}, {"unit", p.unit}, {"rig_file", p.nominal}, {"estimate", p.nominal + p.correction}, {"sigma", p.sigma},
                               {"prior_sigma", p.prior_sigma}, {"paint_shift_sigmas", p.paint_shift}});
  j["silhouette"] = {{"arcs", g.n_arcs}, {"used", e.n_edges}, {"never_lit", g.n_dark_arcs}, {"outliers", e.n_edge_outliers}, {"rms_px", e.edge_rms_px},
                     {"lens_blur_px", g.lens_blur_px}};
  j["highlights"] = {{"views", g.n_views}, {"used", e.n_highlights}, {"rms_px", e.highlight_rms_px}, {"not_found", Json::object()}, {"outliers", Json::array()}};
  for (const auto& [fate, views] : g.rejected) j["highlights"]["not_found"][describe(fate)] = views;
  for (const auto& o : e.outliers) j["highlights"]["outliers"].push_back({{"view", o.view}, {"off_px", {o.residual.x, o.residual.y}}});
  j["sigma"] = {{"half_vector_rad", e.half_vector_sigma_rad}, {"light_rad", e.light_sigma_rad}, {"relative_distance", e.distance_sigma}, {"centre_px", e.centre_sigma_px}};
  if (g.paint.n_samples > 0)
    j["paint"] = {{"samples", g.paint.n_samples}, {"relative_scatter", g.paint.scatter},
                  {"sigma_before", {{"half_vector_rad", g.paint.half_vector_sigma_before}, {"relative_distance", g.paint.distance_sigma_before}}}};
  j["converged"] = e.converged;
  j["warnings"] = e.warnings;
  if (session.rig.kind != acquire::RigDescription::Kind::simulated) return j;
  const auto difference = [](const calib::GeometryDifference& d) {
    return Json{{"half_vector_rad", d.half_vector_rad}, {"light_rad", d.light_rad}, {"relative_distance", d.distance}, {"centre_px", d.centre_px}};
  };
  j["against_truth"] = {{"rig_file", difference(difference_from_truth(session.rig.geometry, 1, {}, session))},
                        {"estimate", difference(difference_from_truth(e.geometry, e.turntable_scale, e.uncertainty, session))}};
  return j;
}

void add_calibrate_geometry(CLI::App& calibrate, Context& context) {
  auto o = std::make_shared<Options>();
  CLI::App* command = calibrate.add_subcommand("geometry", "merged images -> sphere, turntable axis and lights, from silhouette, highlights and the light on the paint");
  command->add_option("session", o->session, "session folder, merged")->required();
  command->add_flag("--from-rig", o->from_rig, "estimate nothing: take the geometry over from the session's rig file");
  command->add_flag("--without-paint", o->without_paint, "silhouette and highlights only, not the pattern of light on the paint");
  add_json_option(*command, context);
  command->callback([o, &context] {
    const acquire::Session session = acquire::read_session(o->session);
    const std::filesystem::path file = session.folder / "calibration.json";
    auto j = json_result(context, {(session.folder / "rig.toml").string()});
    // Response, noise and drift that were found already stay.
    calib::Calibration calibration = std::filesystem::exists(file) ? calib::read_calibration(file) : calib::sensor_calibration(session, stderr_progress(context));
    calib::GeometryOptions options;
    options.use_paint = !o->without_paint;
    if (o->from_rig) {
      calibration.geometry = session.rig.geometry;
      calibration.geometry_source = "rig file";
      calibration.geometry_uncertainty = {};
      calibration.turntable_scale = 1;
    } else if (calib::all_lights_distant(session.rig.geometry)) {
      const auto d = calib::find_distant_lights(session.folder.string(), session.rig.geometry, calib::geometry_views(session, calibration), calibration, {}, stderr_progress(context));
      if (context.json) j.update(distant_lights_json(d)); else print_distant_lights(d);
    } else {
      const calib::SessionGeometry g = calib::estimate_geometry(session, calibration, options, stderr_progress(context));
      if (context.json) j.update(geometry_json(g, session)); else print_geometry(g, session);
    }
    calib::write_calibration(file, calibration, provenance_json(context, {(session.folder / "rig.toml").string()}));
    if (context.json) {
      j.update({{"geometry", calibration.geometry_source}, {"scale", calibration.scale_source}, {"calibration", file.string()}});
      return print_json(j);
    }
    fmt::print("geometry: {}\nscale: {}\ncalibration: {}\n", calibration.geometry_source, calibration.scale_source, file.string());
  });
}

}  // namespace lacquer::tools
