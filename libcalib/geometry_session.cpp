#include "libcalib/geometry_session.h"

#include <fmt/format.h>

#include "libbrdf/error.h"

namespace lacquer::calib {

namespace {

std::string counts_text(const std::map<HighlightFate, std::vector<std::string>>& rejected) {
  std::string text;
  for (const auto& [fate, views] : rejected) text += fmt::format("{}{} {}", text.empty() ? "" : ", ", views.size(), describe(fate));
  return text;
}

}  // namespace

SessionGeometry estimate_geometry(const std::string& name, const acquire::RigGeometry& nominal, const std::vector<GeometryView>& views,
                                  Calibration& calibration, const GeometryPriors& priors, const HighlightOptions& highlight_options,
                                  const Progress& progress) {
  const auto each_view = [&](const std::string& stage, const auto& body) {
    for (std::size_t i = 0; i < views.size(); ++i) {
      body(views[i], views[i].read());
      if (progress) progress(stage, i + 1, views.size());
    }
  };
  OutlineOptions outline_options;
  outline_options.lens_blur_px = calibration.lens_blur_px;
  OutlineFinder finder(nominal, outline_options);
  each_view("silhouette", [&](const GeometryView& view, const RadianceImage& image) {
    finder.add(image, nominal.place_light(view.light, view.turntable_angle));
  });
  const OutlineFinder::Outline outline = finder.finish();

  Calibration trial = calibration;
  trial.geometry = outline.geometry;
  // The lights stay where they are in the room while the origin moves with the sphere.
  if (!outline.edges.empty()) trial.geometry = solve_geometry(nominal, outline.edges, {}, priors).geometry;
  trial.turntable_scale = 1;

  SessionGeometry result;
  result.n_views = views.size();
  result.n_arcs = outline.n_arcs;
  result.n_dark_arcs = outline.n_dark;
  result.edges = outline.edges;
  constexpr int n_passes = 3;
  for (int pass = 0; pass < n_passes; ++pass) {
    result.highlights.clear();
    result.rejected.clear();
    HighlightOptions options = highlight_options;
    if (pass > 0) options.search_rad *= 0.5;
    each_view(pass == 0 ? "highlights" : "highlights again", [&](const GeometryView& view, const RadianceImage& image) {
      HighlightResult found = find_highlight(image, trial, view.light, view.turntable_angle, options);
      found.highlight.view = view.id;
      if (found.fate == HighlightFate::found)
        result.highlights.push_back(found.highlight);
      else
        result.rejected[found.fate].push_back(view.id);
    });
    if (result.highlights.empty())
      throw Error(ErrorCode::input, fmt::format("{}: no highlight in any of {} views ({}): the lights cannot be found with this sphere; photograph a glossy or chrome "
                                                "sphere of the same radius in its place, or keep the rig file's geometry (--from-rig)",
                                                name, views.size(), counts_text(result.rejected)));
    result.estimate = solve_geometry(nominal, outline.edges, result.highlights, priors);
    trial.geometry = result.estimate.geometry;
    trial.turntable_scale = result.estimate.turntable_scale;
  }
  calibration.geometry = trial.geometry;
  calibration.turntable_scale = trial.turntable_scale;
  calibration.geometry_uncertainty = result.estimate.uncertainty;
  calibration.geometry_source = "estimated from highlights and silhouette";
  return result;
}

std::vector<GeometryView> geometry_views(const acquire::Session& session) {
  const acquire::RigDescription& rig = session.rig;
  std::vector<GeometryView> views;
  for (const std::size_t i : session.views_of(acquire::ViewKind::measurement)) {
    const acquire::ViewRecord& view = session.views[i];
    views.push_back({view.id, static_cast<std::size_t>(view.light), view.turntable_angle, [&rig, file = session.radiance_path(view)] {
                       RadianceImage image = read_radiance(file);
                       if (image.width != rig.geometry.camera.width || image.height != rig.geometry.camera.height || image.layout != rig.sensor.layout)
                         throw Error(ErrorCode::file, fmt::format("{}: expected {}x{} {}, as the rig's camera", file.string(), rig.geometry.camera.width,
                                                                  rig.geometry.camera.height, name_of(rig.sensor.layout)));
                       return image;
                     }});
  }
  return views;
}

SessionGeometry estimate_geometry(const acquire::Session& session, Calibration& calibration, const GeometryPriors& priors,
                                  const HighlightOptions& highlight_options, const Progress& progress) {
  return estimate_geometry(session.folder.string(), session.rig.geometry, geometry_views(session), calibration, priors, highlight_options, progress);
}

}  // namespace lacquer::calib
