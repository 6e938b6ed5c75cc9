#include "libcalib/merge_session.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <deque>
#include <memory>
#include <utility>

#include "libcalib/calibration_darks.h"
#include "libcalib/response.h"

namespace lacquer::calib {

namespace {

/// Views whose brackets go into the response: enough to see every level, few enough to stay within seconds and in memory.
constexpr std::size_t response_views = 4;

/// Frames that the system is asked for ahead of the one being read, so that the disk is never idle.
constexpr std::size_t frames_ahead = 12;

constexpr std::size_t frames_at_once = 3;  ///< being read, checked against their checksums and decoded

void ask_for(const std::filesystem::path& file) {
  const int fd = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0) return;  // the reader will say why
  ::posix_fadvise(fd, 0, 0, POSIX_FADV_WILLNEED);
  ::close(fd);
}

std::vector<acquire::RawFrame> read_bracket(const acquire::Session& session, const acquire::ViewRecord& view) {
  std::vector<acquire::RawFrame> frames;
  for (const auto& record : view.frames) frames.push_back(acquire::read_session_frame(session, record));
  return frames;
}

void estimate_sensor_response(const acquire::Session& session, Calibration& calibration) {
  // The first views see most of the lit side: spread over the first half of the session.
  const std::vector<std::size_t> views = session.views_of(acquire::ViewKind::measurement);
  const std::size_t n = views.size(), n_used = std::min(response_views, n);
  std::vector<std::vector<acquire::RawFrame>> brackets;
  for (std::size_t i = 0; i < n_used; ++i) brackets.push_back(read_bracket(session, session.views[views[i * ((n + 1) / 2) / n_used]]));

  ResponseOptions options;
  options.black_level_dn = calibration.noise.black_level_dn;
  options.saturation_dn = calibration.noise.saturation_dn;
  calibration.response = estimate_response(brackets, options).response;
  calibration.response_source = "estimated from the brackets of " + std::to_string(n_used) + " views";
  if (calibration.response.linear) return;
  calibration.noise = estimate_noise(brackets, calibration.response, calibration.noise);
  calibration.noise_source = "estimated from the brackets of " + std::to_string(n_used) + " views";
  calibration.absolute_scale = false;
  calibration.scale_source = "none: relative, the gauge of the estimated response is arbitrary";
}

}  // namespace

bool sensor_needs_session(const acquire::RigDescription& rig) {
  const auto is_dark = [](const acquire::PlannedView& view) { return view.kind == acquire::ViewKind::dark; };
  return rig.sensor.response != acquire::SensorDescription::Response::linear || std::any_of(rig.plan.begin(), rig.plan.end(), is_dark);
}

Calibration sensor_calibration(const acquire::Session& session, const Progress& progress) {
  Calibration calibration = calibration_from_rig(session.rig);
  apply_dark_views(session, calibration, progress);
  if (session.rig.sensor.response == acquire::SensorDescription::Response::linear) return calibration;
  estimate_sensor_response(session, calibration);
  if (!calibration.response.linear) apply_dark_views(session, calibration, progress);  // again, in units of the curve
  return calibration;
}

acquire::SensorNoise bracket_noise(const Calibration& calibration) {
  const NoiseModel& noise = calibration.noise;
  return {.black_level_dn = noise.black_level_dn,
          .saturation_dn = static_cast<double>(saturation_value(noise, calibration.response.bits)),
          .gain_e_per_dn = noise.gain_e_per_dn,
          .read_noise_e = noise.read_noise_e,
          .relative_noise = noise.relative_noise};
}

SessionMerger::SessionMerger(const acquire::RigDescription& rig, std::filesystem::path folder, const Calibration& calibration)
    : calibration_(calibration), folder_(std::move(folder)), follower_(rig) {}

void SessionMerger::add(const acquire::ViewRecord& view, const acquire::RawFrame& frame) {
  if (view.kind == acquire::ViewKind::dark) return;
  if (!merger_ || view.exposures_s != times_) merger_.emplace(calibration_.response, calibration_.noise, view.exposures_s, calibration_.maps);
  times_ = view.exposures_s;
  merger_->add(frame);
}

void SessionMerger::finish_view(const acquire::ViewRecord& view) {
  if (view.kind == acquire::ViewKind::dark) return;
  const auto image = std::make_shared<const RadianceImage>(merger_->finish());
  if (writing_.valid()) writing_.get();
  std::filesystem::create_directories(folder_ / "radiance");
  writing_ = std::async(std::launch::async, [image, file = folder_ / "radiance" / (view.id + ".exr")] { write_radiance(file, *image); });
  follower_.add(view, *image);
}

void SessionMerger::finish(Calibration& calibration) {
  if (writing_.valid()) writing_.get();
  follower_.finish(calibration);
}

void merge_session(const acquire::Session& session, Calibration& calibration, const Progress& progress) {
  SessionMerger merger(session.rig, session.folder, calibration);
  std::vector<std::pair<std::size_t, const acquire::FrameRecord*>> records;
  for (std::size_t v = 0; v < session.views.size(); ++v)
    if (session.views[v].kind != acquire::ViewKind::dark)
      for (const acquire::FrameRecord& record : session.views[v].frames) records.emplace_back(v, &record);
  // The next frames are read while one is merged.
  const auto read = [&](std::size_t k) {
    if (k == 0)
      for (std::size_t ahead = 1; ahead < std::min(frames_ahead, records.size()); ++ahead) ask_for(session.frame_path(*records[ahead].second));
    if (k + frames_ahead < records.size()) ask_for(session.frame_path(*records[k + frames_ahead].second));
    return acquire::read_session_frame(session, *records[k].second);
  };
  std::deque<std::future<acquire::RawFrame>> next;
  for (std::size_t k = 0, asked = 0; k < records.size(); ++k) {
    for (; asked < std::min(k + frames_at_once, records.size()); ++asked) next.push_back(std::async(std::launch::async, read, asked));
    const acquire::RawFrame frame = next.front().get();
    next.pop_front();
    const std::size_t v = records[k].first;
    merger.add(session.views[v], frame);
    if (k + 1 < records.size() && records[k + 1].first == v) continue;
    merger.finish_view(session.views[v]);
    if (progress) progress("merge", v + 1, session.views.size());
  }
  merger.finish(calibration);
}

}  // namespace lacquer::calib
