#include "tools/measure_chain.h"

#include "libacquire/open_rig.h"
#include "libbrdf/files.h"
#include "libcalib/merge_session.h"
#include "tools/fit_metrics.h"
#include "tools/geometry_provenance.h"
#include "tools/stopwatch.h"

namespace lacquer::tools {

Measurement measure(const acquire::RigDescription& rig, std::shared_ptr<const brdf::Brdf> paint, const std::filesystem::path& folder,
                    const MeasureOptions& options, const Progress& progress) {
  Measurement m;
  Stopwatch watch;
  acquire::Rig devices = acquire::open_rig(rig, std::move(paint));
  // Merging runs beside the capture where nothing of the sensor has to be found in its frames first.
  const bool merge_meanwhile = !calib::sensor_needs_session(rig);
  const calib::Calibration nominal = calib::calibration_from_rig(rig);
  calib::SessionMerger merger(rig, folder, nominal);
  acquire::FrameSink sink;
  double merge_seconds = 0;  // on the capture's own thread; what it takes of the capture's time cannot be told apart
  if (merge_meanwhile) {
    sink.frame = [&](const acquire::ViewRecord& view, const acquire::RawFrame& frame) {
      Stopwatch merging;
      merger.add(view, frame);
      merge_seconds += merging.lap();
    };
    sink.view = [&](const acquire::ViewRecord& view) {
      Stopwatch merging;
      merger.finish_view(view);
      merge_seconds += merging.lap();
    };
  }
  m.session = acquire::capture_session(devices, rig, folder, {.command_line = options.command_line, .resume = options.resume,
                                       .before_frames = options.before_frames, .noise = calib::bracket_noise(nominal)}, progress, sink);
  m.n_views = m.session.views.size();
  for (const auto& view : m.session.views) m.n_frames += view.frames.size();
  m.seconds.emplace_back(merge_meanwhile ? "capture and merge" : "capture", watch.lap());
  if (merge_meanwhile) m.seconds.emplace_back("of this merge", merge_seconds);

  m.calibration = calib::sensor_calibration(m.session, progress);
  if (merge_meanwhile) {
    merger.finish(m.calibration);
  } else {
    m.seconds.emplace_back("sensor", watch.lap());
    calib::merge_session(m.session, m.calibration, progress);
    m.seconds.emplace_back("merge", watch.lap());
  }
  if (options.calibrate_geometry) {
    m.geometry = calib::estimate_geometry(m.session, m.calibration, {}, progress);
    m.seconds.emplace_back("geometry", watch.lap());
  }
  calib::write_calibration(folder / "calibration.json", m.calibration, options.provenance_json);
  m.tabulation = calib::tabulate_session(m.session, m.calibration, options.samples, progress);
  m.tabulation.table.provenance_json = with_geometry_sigma(options.provenance_json, m.tabulation.geometry_sigma);
  m.seconds.emplace_back("tabulate", watch.lap());

  brdf::write_table(folder / "table.exr", m.tabulation.table);
  m.seconds.emplace_back("write table", watch.lap());
  fit::FitOptions fit_options = options.fit;
  fit_options.half_vector_sigma = m.tabulation.geometry_sigma.half_vector_rad;
  m.fit = fit::fit_and_free_places(m.tabulation.table, fit_options, progress);
  m.seconds.emplace_back("fit", watch.lap());
  const brdf::TableBrdf measured(std::move(m.tabulation.table), "table");
  add_metrics(measured, m.fit);
  m.tabulation.table = measured.table();
  fit::write_fit(folder / "fit.json", m.fit, m.tabulation.table.absolute_scale, options.provenance_json);
  m.seconds.emplace_back("metrics", watch.lap());
  calib::RerenderOptions rerender;
  rerender.samples = options.samples;
  m.view_errors = calib::rerender_session(m.session, m.calibration, brdf::CookTorranceBrdf(m.fit.model), rerender,
                                          folder / "rerendered.png", progress);
  m.seconds.emplace_back("re-render", watch.lap());
  return m;
}

}  // namespace lacquer::tools
