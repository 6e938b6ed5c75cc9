#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <future>
#include <memory>

#include "libacquire/session.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::acquire {

namespace {

namespace fs = std::filesystem;

/// Lights off and motor held, however the capture ends.
struct SafeEnd {
  Rig& rig;
  ~SafeEnd() {
    rig.lights->off();
    rig.turntable->hold();
  }
};

/// A view between capture and record. Destruction waits for the disk (the future comes from std::async).
struct PendingView {
  ViewRecord record;
  std::vector<RawFrame> frames;
  std::future<std::vector<std::string>> checksums;
};

void check_folder(const fs::path& folder) {
  std::error_code status;
  if (!fs::exists(folder, status)) return;
  if (!fs::is_directory(folder, status)) throw Error(ErrorCode::file, folder.string() + ": is a file; expected a folder for the session");
  if (fs::exists(folder / "session.json", status))
    throw Error(ErrorCode::file, folder.string() + ": has a session already (session.json); choose another folder or remove it");
  if (!fs::is_empty(folder, status))
    throw Error(ErrorCode::file, folder.string() + ": folder is not empty and has no session.json (an interrupted capture?); choose another "
                                                   "folder or remove it");
}

void check_space(const fs::path& folder, const RigDescription& rig) {
  double n_frames = 0;
  for (const PlannedView& view : rig.plan) n_frames += static_cast<double>(view.exposures_s.size());
  const CameraModel& camera = rig.geometry.camera;
  const double needed = n_frames * camera.width * camera.height * values_per_pixel(rig.sensor.layout) * (rig.sensor.bits == 8 ? 1 : 2);
  std::error_code status;
  const fs::space_info space = fs::space(folder, status);
  if (!status && static_cast<double>(space.available) < needed)
    throw Error(ErrorCode::file, fmt::format("{}: the frames need {:.1f} GB, {:.1f} GB are free", folder.string(), needed * 1e-9,
                                             static_cast<double>(space.available) * 1e-9));
}

/// rig.toml and the files it refers to go into the session. rig/: numbered, so that equal names from different folders stay apart.
void store_rig(Session& session) {
  std::vector<std::pair<std::string, std::string>> copies;
  const RigDescription& rig = session.rig;
  auto mask = rig.mask.file;
  if (!rig.referenced_files.empty()) fs::create_directories(session.folder / "rig");
  for (const ReferencedFile& file : rig.referenced_files) {
    const std::string copy = fmt::format("rig/{}{}", copies.size(), file.resolved.extension().string());
    std::error_code status;
    fs::copy_file(file.resolved, session.folder / copy, status);
    if (status) throw Error(ErrorCode::file, fmt::format("{}: cannot be copied to the session: {}", file.resolved.string(), status.message()));
    session.rig_files[copy] = brdf::file_checksum(session.folder / copy);
    copies.emplace_back(file.as_written, copy);
    if (rig.mask.file == file.resolved) mask = session.folder / copy;
  }
  brdf::write_text_atomically(session.folder / "rig.toml", with_copied_files(rig.text, copies));
  session.rig_files["rig.toml"] = brdf::file_checksum(session.folder / "rig.toml");
  session.rig.file = session.folder / "rig.toml";
  session.rig.mask.file = mask;
}

std::vector<std::string> write_frames(const fs::path& folder, const ViewRecord& record, const std::vector<RawFrame>& frames) {
  std::vector<std::string> checksums;
  for (std::size_t i = 0; i < frames.size(); ++i) checksums.push_back(write_frame((folder / record.frames[i].file).string(), frames[i]));
  return checksums;
}

std::unique_ptr<PendingView> capture_view(Rig& rig, const RigDescription& description, std::size_t index) {
  const PlannedView& planned = description.plan[index];
  auto view = std::make_unique<PendingView>();
  view->record.id = fmt::format("L{:03d}", index);
  view->record.light = planned.light;
  view->record.turntable_angle = rig.turntable->move_to(planned.turntable_angle);
  rig.lights->on(planned.light);
  for (std::size_t e = 0; e < planned.exposures_s.size(); ++e) {
    FrameRecord record;
    record.file = fmt::format("frames/{}_E{:02d}.tiff", view->record.id, e);
    view->frames.push_back(rig.camera->capture({.exposure_s = planned.exposures_s[e], .gain_db = 0}));
    const RawFrame& frame = view->frames.back();
    check_format(frame, description, fmt::format("frame {} of {}", record.file, rig.camera->description()));
    record.exposure_s = frame.actual.exposure_s;
    record.gain_db = frame.actual.gain_db;
    if (e < planned.files.size()) record.source = planned.files[e].string();
    view->record.frames.push_back(std::move(record));
  }
  return view;  // the light stays on: an LED that is switched between views is never warm
}

}  // namespace

Session capture_session(Rig& rig, const RigDescription& description, const fs::path& folder, const std::string& command_line,
                        const Progress& progress, const ViewSink& sink) {
  check_folder(folder);
  const SafeEnd safe_end{rig};
  Session session;
  session.folder = folder;
  session.rig = description;
  session.software = std::string("lacquer ") + brdf::version();
  session.command_line = command_line;
  std::error_code status;
  fs::create_directories(folder / "frames", status);
  if (status) throw Error(ErrorCode::file, fmt::format("{}: cannot be created: {}", folder.string(), status.message()));
  check_space(folder, description);
  store_rig(session);

  const auto report = [&](std::size_t done) {
    if (progress) progress("capture", done, description.plan.size());
  };
  const auto finish = [&](PendingView& view) {
    const auto checksums = view.checksums.get();
    for (std::size_t i = 0; i < checksums.size(); ++i) view.record.frames[i].checksum = checksums[i];
    if (sink) sink(view.record, view.frames);
    session.views.push_back(std::move(view.record));
    report(session.views.size());
  };

  report(0);
  std::unique_ptr<PendingView> pending;
  for (std::size_t i = 0; i < description.plan.size(); ++i) {
    auto view = capture_view(rig, description, i);
    if (pending) finish(*pending);
    pending = std::move(view);
    pending->checksums = std::async(std::launch::async, write_frames, folder, std::cref(pending->record), std::cref(pending->frames));
  }
  if (pending) finish(*pending);
  write_session(session);
  return session;
}

}  // namespace lacquer::acquire
