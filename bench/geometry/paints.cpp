#include "paints.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "libacquire/session.h"
#include "libacquire/sim/simulated_world.h"
#include "libbrdf/brdf.h"
#include "libbrdf/error.h"
#include "libcalib/merge.h"
#include "libcalib/radiance_image.h"
#include "libcalib/samples.h"
#include "tools/stopwatch.h"

namespace lacquer::bench {

namespace {

constexpr double degree = std::numbers::pi / 180;

bool contributes(const brdf::CookTorrance& paint, std::size_t lobe) {
  constexpr double least = 0.05;
  brdf::CookTorrance alone;
  alone.lobes = {paint.lobes[lobe]};
  for (double d = 0; d <= 80; d += 20)
    for (double h = 0; h <= 80; h += 0.5) {
      const brdf::Directions directions = brdf::directions({h * degree, d * degree, std::numbers::pi / 2});
      if (!(directions.wi.z > 0.1 && directions.wo.z > 0.1)) continue;
      const auto cosines = brdf::half_angle_cosines(directions);
      const glm::dvec3 part = alone.value(cosines), all = paint.value(cosines);
      for (int c = 0; c < 3; ++c)
        if (part[c] > least * all[c]) return true;
    }
  return false;
}

std::vector<LobeError> lobe_errors(const brdf::CookTorrance& truth, const brdf::CookTorrance& fit) {
  std::vector<LobeError> errors;
  for (std::size_t i = 0; i < truth.lobes.size(); ++i) {
    if (!contributes(truth, i)) continue;
    LobeError e{i + 1, truth.lobes[i].m, 0};
    for (const auto& lobe : fit.lobes)
      if (lobe.ks != glm::dvec3(0.0) && (e.m == 0 || std::abs(std::log(lobe.m / e.true_m)) < std::abs(std::log(e.m / e.true_m)))) e.m = lobe.m;
    errors.push_back(e);
  }
  return errors;
}

PaintFit fit_session(const acquire::Session& session, const calib::Calibration& calibration, const brdf::CookTorranceBrdf& truth) {
  const calib::Tabulation tabulation = calib::tabulate_session(session, calibration, {}, {});
  const fit::FitResult fit = fit::fit_table(tabulation.table, {}, {});
  PaintFit result;
  result.difference = brdf::compare(truth, brdf::CookTorranceBrdf(fit.model));
  result.lobes = lobe_errors(truth.model(), fit.model);
  result.reduced_chi2 = fit.reduced_chi2;
  return result;
}

std::string lobes_text(const std::vector<LobeError>& lobes) {
  std::string text;
  for (const LobeError& e : lobes)
    text += e.m > 0 ? fmt::format(" m{} {:+.2f} %", e.lobe, 100 * (e.m / e.true_m - 1)) : fmt::format(" m{} lost", e.lobe);
  return text;
}

}  // namespace

PaintResult measure_paint(const acquire::RigDescription& nominal, const BuilderErrors& errors, const std::filesystem::path& paint_file,
                          const std::filesystem::path& folder) {
  PaintResult result;
  result.paint = paint_file.stem().string();
  const std::shared_ptr<const brdf::Brdf> paint = brdf::load_brdf(paint_file);
  const auto* truth = dynamic_cast<const brdf::CookTorranceBrdf*>(paint.get());
  if (truth == nullptr) throw Error(ErrorCode::input, fmt::format("{}: expected a Cook-Torrance paint", paint_file.string()));
  tools::Stopwatch watch;
  const acquire::RigDescription built = built_with(nominal, errors);
  acquire::sim::SimulatedWorld world(built, paint);
  calib::Calibration calibration = calib::calibration_from_rig(nominal);
  acquire::Session session;
  session.folder = folder;
  session.rig = nominal;
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder / "radiance");
  std::vector<double> scaled;
  for (const acquire::PlannedView& planned : built.plan) {
    acquire::ViewRecord view;
    view.id = fmt::format("L{:03}", session.views.size());
    view.light = planned.light;
    view.exposures_s = planned.exposures_s;
    view.turntable_angle = world.move_to(planned.turntable_angle);
    world.switch_light(planned.light);
    calib::BracketMerger merger(calibration.response, calibration.noise, planned.exposures_s);
    for (const double exposure : planned.exposures_s) merger.add(world.photograph({.exposure_s = exposure}));
    calib::write_radiance(session.radiance_path(view), merger.finish());
    scaled.push_back(view.turntable_angle);
    session.views.push_back(std::move(view));
  }
  result.simulation_s = watch.lap();

  calib::Calibration known = calibration;
  known.geometry = world.geometry();
  known.geometry_source = "simulated truth";
  result.known = fit_session(session, known, *truth);
  result.fits_s = watch.lap();

  // What the rig's own computer knows: the angles as its turntable counts them.
  for (acquire::ViewRecord& view : session.views) view.turntable_angle /= errors.step_scale;
  calib::estimate_geometry(session, calibration, {}, {});
  result.geometry_s = watch.lap();
  std::vector<calib::ViewAngles> angles;
  for (std::size_t i = 0; i < session.views.size(); ++i)
    angles.push_back({static_cast<std::size_t>(session.views[i].light), calib::illumination_of(session.views[i], calibration).turntable_angle, scaled[i]});
  result.geometry = calib::geometry_difference(calibration.geometry, world.geometry(), angles);
  result.calibrated = fit_session(session, calibration, *truth);
  result.fits_s += watch.lap();
  std::filesystem::remove_all(folder);
  return result;
}

std::string paint_table(const std::vector<PaintResult>& results) {
  std::string text = fmt::format("{:<16} {:>12} {:>12} {:>10} {:>9} {:>9} {:>7}   {}\n", "paint", "mean |ln|", "mean |ln|", "half vec.", "light", "distance", "time",
                                 "m of the lobes that contribute, error: known geometry; calibrated");
  text += fmt::format("{:<16} {:>12} {:>12} {:>10} {:>9} {:>9} {:>7}\n", "", "known", "calibrated", "deg", "deg", "%", "s");
  for (const PaintResult& r : results)
    text += fmt::format("{:<16} {:>12.5f} {:>12.5f} {:>10.4f} {:>9.4f} {:>9.3f} {:>7.0f}  {};{}\n", r.paint, r.known.difference.mean_abs_log,
                        r.calibrated.difference.mean_abs_log, r.geometry.half_vector_rad / degree, r.geometry.light_rad / degree, 100 * r.geometry.distance,
                        r.simulation_s + r.geometry_s + r.fits_s, lobes_text(r.known.lobes), lobes_text(r.calibrated.lobes));
  return text;
}

}  // namespace lacquer::bench
