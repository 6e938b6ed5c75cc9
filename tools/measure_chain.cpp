#include "tools/measure_chain.h"

#include <chrono>

#include "libacquire/open_rig.h"
#include "libacquire/session.h"
#include "libbrdf/files.h"
#include "libcalib/merge.h"
#include "libcalib/merge_session.h"

namespace lacquer::tools {

namespace {

class Stopwatch {
 public:
  double lap() {
    const auto now = std::chrono::steady_clock::now();
    return std::chrono::duration<double>(now - std::exchange(last_, now)).count();
  }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

/// Frames of one view -> radiance file -> samples in the table, with the time of each.
class ViewProcessor {
 public:
  ViewProcessor(const calib::Calibration& calibration, const acquire::RigDescription& rig, std::filesystem::path folder,
                const calib::SampleOptions& options)
      : calibration_(calibration),
        folder_(std::move(folder)),
        sampler_(calibration, rig.mask, rig.sensor.layout, options),
        accumulator_(static_cast<std::size_t>(acquire::n_channels(rig.sensor.layout))) {}

  void add(const acquire::ViewRecord& view, const std::vector<acquire::RawFrame>& frames) {
    Stopwatch watch;
    const calib::RadianceImage image = calib::merge_bracket(frames, calibration_.response, calibration_.noise);
    std::filesystem::create_directories(folder_ / "radiance");
    calib::write_radiance(folder_ / "radiance" / (view.id + ".exr"), image);
    merge_seconds += watch.lap();
    counts_ += sampler_.sample_view(image, static_cast<std::size_t>(view.light), view.turntable_angle, [&](auto samples) {
      for (const calib::Sample& s : samples)
        accumulator_.add(static_cast<std::size_t>(s.channel), s.coordinates, s.value, s.variance, s.weight, s.footprint);
    });
    tabulate_seconds += watch.lap();
  }

  calib::Tabulation finish() {
    Stopwatch watch;
    calib::Tabulation result{accumulator_.table(true), counts_};
    result.table.absolute_scale = calibration_.absolute_scale;
    tabulate_seconds += watch.lap();
    return result;
  }

  double merge_seconds = 0, tabulate_seconds = 0;

 private:
  const calib::Calibration& calibration_;
  std::filesystem::path folder_;
  calib::Sampler sampler_;
  brdf::TableAccumulator accumulator_;
  calib::SampleCounts counts_;
};

}  // namespace

Measurement measure(const acquire::RigDescription& rig, std::shared_ptr<const brdf::Brdf> paint, const std::filesystem::path& folder,
                    const MeasureOptions& options, const Progress& progress) {
  Measurement m;
  m.calibration = calib::calibration_from_rig(rig);
  const bool response_known = rig.sensor.response == acquire::SensorDescription::Response::linear;
  Stopwatch watch;

  acquire::Rig devices = acquire::open_rig(rig, std::move(paint));
  std::unique_ptr<ViewProcessor> processor;
  if (response_known) processor = std::make_unique<ViewProcessor>(m.calibration, rig, folder, options.samples);
  const auto sink = [&](const acquire::ViewRecord& view, const std::vector<acquire::RawFrame>& frames) {
    if (processor) processor->add(view, frames);
  };
  const acquire::Session session = acquire::capture_session(devices, rig, folder, options.command_line, progress, sink);
  m.n_views = session.views.size();
  for (const auto& view : session.views) m.n_frames += view.frames.size();
  m.seconds.emplace_back("capture", watch.lap() - (processor ? processor->merge_seconds + processor->tabulate_seconds : 0));

  if (!response_known) {
    calib::estimate_session_response(session, m.calibration);
    m.seconds.emplace_back("response", watch.lap());
    processor = std::make_unique<ViewProcessor>(m.calibration, rig, folder, options.samples);
    for (std::size_t i = 0; i < session.views.size(); ++i) {
      std::vector<acquire::RawFrame> frames;
      for (const auto& record : session.views[i].frames) frames.push_back(acquire::read_session_frame(session, record));
      processor->add(session.views[i], frames);
      if (progress) progress("merge", i + 1, session.views.size());
    }
  }
  calib::write_calibration(folder / "calibration.json", m.calibration, options.provenance_json);
  m.tabulation = processor->finish();
  m.tabulation.table.provenance_json = options.provenance_json;
  m.seconds.emplace_back("merge", processor->merge_seconds);
  m.seconds.emplace_back("tabulate", processor->tabulate_seconds);
  processor.reset();
  watch.lap();

  brdf::write_table(folder / "table.exr", m.tabulation.table);
  m.seconds.emplace_back("write table", watch.lap());
  m.fit = fit::fit_table(m.tabulation.table, options.fit, progress);
  fit::write_fit(folder / "fit.json", m.fit, m.tabulation.table.absolute_scale, options.provenance_json);
  m.seconds.emplace_back("fit", watch.lap());
  calib::RerenderOptions rerender;
  rerender.samples = options.samples;
  m.view_errors = calib::rerender_session(session, m.calibration, brdf::CookTorranceBrdf(m.fit.model), rerender,
                                          folder / "rerendered.png", progress);
  m.seconds.emplace_back("re-render", watch.lap());
  return m;
}

}  // namespace lacquer::tools
