#include <fmt/format.h>

#include <algorithm>
#include <optional>

#include "libacquire/capture_clock.h"
#include "libacquire/capture_journal.h"
#include "libacquire/frame_writer.h"
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

/// What lies in the folder already.
enum class Found { nothing, begun, complete };

Found look_into(const fs::path& folder, bool resume) {
  std::error_code status;
  if (fs::exists(folder / "session.json", status)) {
    if (resume) return Found::complete;
    throw Error(ErrorCode::file, folder.string() + ": has a session already (session.json); choose another folder or remove it");
  }
  if (const auto journal = read_journal(folder)) {
    if (resume) return Found::begun;
    throw Error(ErrorCode::file, fmt::format("{}: has a capture that did not end ({} frames); complete it with --resume or choose another folder",
                                             folder.string(), journal->frames.size()));
  }
  return Found::nothing;
}

/// Only a folder that is new, empty or of a capture that ended before its first frame may be written into.
void check_folder(const fs::path& folder, bool resume) {
  std::error_code status;
  if (!fs::exists(folder, status)) return;
  if (!fs::is_directory(folder, status)) throw Error(ErrorCode::file, folder.string() + ": is a file; expected a folder for the session");
  if (look_into(folder, resume) != Found::nothing || fs::is_empty(folder, status)) return;
  for (const auto& entry : fs::directory_iterator(folder)) {
    const std::string name = entry.path().filename().string();
    const bool ours = name == "frames" || name == "rig" || name == "rig.toml" || name == "capture.lock" || name == "capture.jsonl" ||
                      (name.starts_with(".") && name.find(".tmp") != std::string::npos);
    if (!ours) throw Error(ErrorCode::file, fmt::format("{}: is not empty ({}) and no capture of Lacquer's; choose another folder", folder.string(), name));
  }
}

void check_space(const fs::path& folder, const RigDescription& rig, std::size_t n_kept) {
  double n_frames = -static_cast<double>(n_kept);
  for (const PlannedView& view : rig.plan) n_frames += static_cast<double>(view.exposures_s.size());
  const CameraModel& camera = rig.geometry.camera;
  const double needed = n_frames * camera.width * camera.height * values_per_pixel(rig.sensor.layout) * (rig.sensor.bits == 8 ? 1 : 2);
  std::error_code status;
  const fs::space_info space = fs::space(folder, status);
  if (!status && static_cast<double>(space.available) < needed)
    throw Error(ErrorCode::file, fmt::format("{}: the frames need {:.1f} GB, {:.1f} GB are free", folder.string(), needed * 1e-9,
                                             static_cast<double>(space.available) * 1e-9));
}

/// What goes into the session of the rig file and the files it refers to.
struct RigCopies {
  std::string text;                               ///< of rig.toml
  std::vector<std::pair<fs::path, fs::path>> files;  ///< from, to
};

/// rig/: numbered, so that equal names from different folders stay apart. Sets session.rig_files and the paths in session.rig; writes nothing.
RigCopies plan_rig_copies(Session& session) {
  RigCopies copies;
  std::vector<std::pair<std::string, std::string>> names;
  RigDescription& rig = session.rig;
  const RigDescription original = rig;
  for (const ReferencedFile& file : original.referenced_files) {
    const std::string copy = fmt::format("rig/{}{}", names.size(), file.resolved.extension().string());
    session.rig_files[copy] = brdf::file_checksum(file.resolved);
    names.emplace_back(file.as_written, copy);
    copies.files.emplace_back(file.resolved, session.folder / copy);
    if (original.mask.file == file.resolved) rig.mask.file = session.folder / copy;
    if (original.sensor.noise_file == file.resolved) rig.sensor.noise_file = session.folder / copy;
    if (original.sensor.maps_file == file.resolved) rig.sensor.maps_file = session.folder / copy;
  }
  copies.text = with_copied_files(rig.text, names);
  session.rig_files["rig.toml"] = brdf::checksum(std::as_bytes(std::span(copies.text)));
  rig.file = session.folder / "rig.toml";
  return copies;
}

void write_rig_copies(const Session& session, const RigCopies& copies) {
  if (!copies.files.empty()) fs::create_directories(session.folder / "rig");
  for (const auto& [from, to] : copies.files) {
    std::error_code status;
    fs::copy_file(from, to, fs::copy_options::overwrite_existing, status);
    if (status) throw Error(ErrorCode::file, fmt::format("{}: cannot be copied to the session: {}", from.string(), status.message()));
  }
  brdf::write_text_atomically(session.folder / "rig.toml", copies.text);
}

/// A complete session, as if it had just been captured.
Session hand_over(Session session, const Progress& progress, const FrameSink& sink) {
  for (std::size_t v = 0; v < session.views.size(); ++v) {
    ViewRecord view = session.views[v];
    std::vector<FrameRecord> frames;
    std::swap(frames, view.frames);
    for (const FrameRecord& record : frames) {
      view.frames.push_back(record);
      if (sink.frame) sink.frame(view, read_session_frame(session, record));
    }
    if (sink.view) sink.view(view);
    if (progress) progress("read", v + 1, session.views.size());
  }
  return session;
}

/// The rig file and what it refers to are as they were when the capture began.
void check_rig_files(const Session& session, const JournalContent& journal) {
  for (const auto& [name, checksum] : journal.rig_files) {
    const auto now = session.rig_files.find(name);
    if (now == session.rig_files.end() || now->second != checksum)
      throw Error(ErrorCode::file, fmt::format("{}: the rig file (or a file it names) is not the one this capture began with; resume with that one",
                                               (session.folder / name).string()));
  }
}

/// Files whose writing was cut short.
void remove_temporary_files(const fs::path& folder) {
  for (const fs::path& place : {folder, folder / "frames"})
    for (const auto& entry : fs::directory_iterator(place)) {
      const std::string name = entry.path().filename().string();
      if (name.starts_with(".") && name.find(".tmp") != std::string::npos) fs::remove(entry.path());
    }
}

/// A recorded frame that is on disk as it was.
const FrameRecord* kept_frame(const Session& session, const JournalContent& journal, std::size_t view, std::size_t exposure) {
  const auto found = journal.frames.find({view, exposure});
  if (found == journal.frames.end() || found->second.file != frame_name(session.rig.plan[view].id, exposure)) return nullptr;
  std::error_code status;
  const fs::path file = session.folder / found->second.file;
  return fs::is_regular_file(file, status) && brdf::file_checksum(file) == found->second.checksum ? &found->second : nullptr;
}

FrameWriter::Item take_frame(Rig& rig, const RigDescription& description, const CaptureClock& clock, std::size_t view, std::size_t exposure) {
  const PlannedView& planned = description.plan[view];
  FrameWriter::Item item{.view = view, .exposure = exposure, .record = {}, .frame = {}};
  item.record.file = frame_name(planned.id, exposure);
  const double time = clock.now();
  item.frame = rig.camera->capture({.exposure_s = planned.exposures_s[exposure], .gain_db = 0});
  check_format(item.frame, description, fmt::format("frame {} of {}", item.record.file, rig.camera->description()));
  item.record.exposure_s = item.frame.actual.exposure_s;
  item.record.gain_db = item.frame.actual.gain_db;
  item.record.time_s = rig.frame_time ? rig.frame_time() : time;
  if (exposure < planned.files.size()) item.record.source = planned.files[exposure].string();
  return item;
}

double last_frame_time(const JournalContent& journal) {
  double last = 0;
  for (const auto& [place, record] : journal.frames) last = std::max(last, record.time_s.value_or(0) + record.exposure_s);
  return last;
}

/// All views of the plan; those on disk are only handed over, without moving anything.
void run_plan(Rig& rig, const RigDescription& description, const Session& session, const JournalContent& journal, const CaptureClock& clock,
              FrameWriter& writer, const Progress& progress) {
  std::size_t n_frames = 0, done = 0;
  for (const PlannedView& view : description.plan) n_frames += view.exposures_s.size();
  const auto report = [&] {
    if (progress) progress("capture", done, n_frames);
  };
  report();
  for (std::size_t v = 0; v < description.plan.size(); ++v) {
    const PlannedView& planned = description.plan[v];
    std::vector<const FrameRecord*> kept;
    for (std::size_t e = 0; e < planned.exposures_s.size(); ++e) kept.push_back(kept_frame(session, journal, v, e));
    const auto known_angle = journal.angles.find(v);
    std::optional<double> angle;
    if (known_angle != journal.angles.end()) angle = known_angle->second;
    if (!angle || std::count(kept.begin(), kept.end(), nullptr) > 0) {
      const double now = rig.turntable->move_to(planned.turntable_angle);
      if (!angle) angle = now;
      if (planned.kind == ViewKind::dark)
        rig.lights->off();
      else
        rig.lights->on(planned.light);  // and stays on: an LED that is switched between frames is never warm
    }
    writer.begin_view(v, *angle, known_angle != journal.angles.end());
    for (std::size_t e = 0; e < planned.exposures_s.size(); ++e) {
      if (kept[e]) {
        if (rig.frame_exists) rig.frame_exists(v, e);
        writer.push({.view = v, .exposure = e, .record = *kept[e], .frame = {}, .on_disk = true});
      } else {
        writer.push(take_frame(rig, description, clock, v, e));
      }
      ++done;
      report();
    }
  }
}

}  // namespace

std::string frame_name(const std::string& view_id, std::size_t exposure) { return fmt::format("frames/{}_E{:02d}.tiff", view_id, exposure); }

Session capture_session(Rig& rig, const RigDescription& description, const fs::path& folder, const CaptureOptions& options,
                        const Progress& progress, const FrameSink& sink) {
  const SafeEnd safe_end{rig};
  check_folder(folder, options.resume);
  std::error_code status;
  fs::create_directories(folder / "frames", status);
  if (status) throw Error(ErrorCode::file, fmt::format("{}: cannot be created: {}", folder.string(), status.message()));
  const SessionLock lock(folder);
  const Found found = look_into(folder, options.resume);  // nobody else can change it now
  if (found == Found::complete) {
    fs::remove(folder / "capture.jsonl", status);  // the last capture was killed between writing session.json and this
    return hand_over(read_session(folder), progress, sink);
  }

  Session session;
  session.folder = folder;
  session.rig = description;
  session.software = std::string("lacquer ") + brdf::version();
  session.command_line = options.command_line;
  const RigCopies copies = plan_rig_copies(session);
  remove_temporary_files(folder);
  JournalContent journal;
  if (found == Found::begun) {
    journal = *read_journal(folder);
    check_rig_files(session, journal);
    session.command_line = journal.command_line;
  } else {
    write_rig_copies(session, copies);
  }
  check_space(folder, description, journal.frames.size());
  if (options.before_frames) options.before_frames(rig);

  if (found == Found::nothing) journal.begun_unix_s = unix_time();
  CaptureJournal lines(folder, session, found == Found::nothing, journal.begun_unix_s);
  const CaptureClock clock(found == Found::nothing ? 0 : elapsed_since(journal.begun_unix_s, unix_time(), last_frame_time(journal)));
  FrameWriter writer(session, lines, sink);
  run_plan(rig, description, session, journal, clock, writer, progress);
  writer.finish();
  write_session(session);
  lines.remove();
  return session;
}

}  // namespace lacquer::acquire
