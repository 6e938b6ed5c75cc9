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

SessionGeometry estimate_geometry(const acquire::Session& session, Calibration& calibration, const GeometryPriors& priors,
                                  const HighlightOptions& highlight_options, const Progress& progress) {
  const acquire::RigGeometry& nominal = session.rig.geometry;
  const std::vector<std::size_t> views = session.views_of(acquire::ViewKind::measurement);
  const auto each_view = [&](const std::string& stage, const auto& body) {
    for (std::size_t i = 0; i < views.size(); ++i) {
      const acquire::ViewRecord& view = session.views[views[i]];
      const RadianceImage image = read_radiance(session.radiance_path(view));
      if (image.width != nominal.camera.width || image.height != nominal.camera.height || image.layout != session.rig.sensor.layout)
        throw Error(ErrorCode::file, fmt::format("{}: expected {}x{} {}, as the rig's camera", session.radiance_path(view).string(),
                                                 nominal.camera.width, nominal.camera.height, name_of(session.rig.sensor.layout)));
      body(view, image);
      if (progress) progress(stage, i + 1, views.size());
    }
  };
  OutlineOptions outline_options;
  outline_options.lens_blur_px = calibration.lens_blur_px;
  OutlineFinder finder(nominal, outline_options);
  each_view("silhouette", [&](const acquire::ViewRecord& view, const RadianceImage& image) {
    finder.add(image, nominal.place_light(static_cast<std::size_t>(view.light), view.turntable_angle));
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
  constexpr int n_passes = 3;
  for (int pass = 0; pass < n_passes; ++pass) {
    result.highlights.clear();
    result.rejected.clear();
    HighlightOptions options = highlight_options;
    if (pass > 0) options.search_rad *= 0.5;
    each_view(pass == 0 ? "highlights" : "highlights again", [&](const acquire::ViewRecord& view, const RadianceImage& image) {
      HighlightResult found = find_highlight(image, trial, static_cast<std::size_t>(view.light), view.turntable_angle, options);
      found.highlight.view = view.id;
      if (found.fate == HighlightFate::found)
        result.highlights.push_back(found.highlight);
      else
        result.rejected[found.fate].push_back(view.id);
    });
    if (result.highlights.empty())
      throw Error(ErrorCode::input, fmt::format("{}: no highlight in any of {} views ({}): the lights cannot be found with this sphere; photograph a glossy or chrome "
                                                "sphere of the same radius in its place, or keep the rig file's geometry (--from-rig)",
                                                session.folder.string(), views.size(), counts_text(result.rejected)));
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

}  // namespace lacquer::calib
