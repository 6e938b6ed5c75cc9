#include <fmt/format.h>

#include <algorithm>
#include <map>
#include <optional>

#include "libacquire/adaptive_bracket.h"
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
      throw Error(ErrorCode::file, fmt::format("{}: the rig file (or a file it names) is not the one this capture began with; resume with that one, or choose another folder",
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

/// Carries out a plan view by view. Frames that are on disk are only handed over, without moving anything.
class PlanRunner {
 public:
  PlanRunner(Rig& rig, const RigDescription& description, const Session& session, const JournalContent& journal, const CaptureClock& clock,
             const CaptureOptions& options, FrameWriter& writer, const Progress& progress)
      : rig_(rig), description_(description), session_(session), journal_(journal), clock_(clock), options_(options), writer_(writer),
        progress_(progress) {
    for (const PlannedView& view : description.plan) n_frames_ += view.exposures_s.size();
    if (!description.adaptive_loss) return;
    if (!options.noise) throw Error(ErrorCode::usage, "an adaptive bracket needs the noise of the sensor");
    bracket_.emplace(description, *options.noise);
  }

  void run() {
    report();
    for (std::size_t v = 0; v < description_.plan.size(); ++v) run_view(v);
  }

 private:
  using Items = std::map<std::size_t, FrameWriter::Item>;  // by exposure

  void report() const {
    if (progress_) progress_("capture", n_done_, n_frames_);
  }

  /// Turntable and light as planned; returns the angle read back.
  double go_to(std::size_t v) {
    const PlannedView& planned = description_.plan[v];
    if (options_.before_view) options_.before_view(v);
    const double angle = rig_.turntable->move_to(planned.turntable_angle);
    if (planned.kind == ViewKind::dark)
      rig_.lights->off();
    else
      rig_.lights->on(planned.light);  // and stays on: an LED that is switched between frames is never warm
    return angle;
  }

  /// What the journal has of a view, if it holds together with the plan.
  const JournalContent::View* begun_view(std::size_t v) const {
    const auto found = journal_.views.find(v);
    if (found == journal_.views.end()) return nullptr;
    const auto& bracket = found->second.bracket;
    if (bracket && (bracket->first > bracket->last || bracket->last >= description_.plan[v].exposures_s.size()))
      throw Error(ErrorCode::file, fmt::format("{}: view {}: bracket: not one of the plan; the capture cannot be resumed",
                                               (session_.folder / "capture.jsonl").string(), v));
    return &found->second;
  }

  void run_view(std::size_t v) {
    const PlannedView& planned = description_.plan[v];
    const auto& times = planned.exposures_s;
    ViewRecord record{planned.id, 0, planned.light, planned.kind};
    const JournalContent::View* begun = begun_view(v);
    Items items;  // on disk, or taken to choose the bracket
    if (begun) {
      record.turntable_angle = begun->turntable_angle;
      record.bracket = begun->bracket;
      for (std::size_t e = 0; e < times.size(); ++e)
        if (const FrameRecord* kept = kept_frame(session_, journal_, v, e)) items[e] = {.view = v, .exposure = e, .record = *kept, .frame = {}, .on_disk = true};
    } else {
      record.turntable_angle = go_to(v);
      if (bracket_ && planned.kind != ViewKind::dark)
        record.bracket = bracket_->choose(planned, record.turntable_angle, [&](std::size_t e) -> const RawFrame& {
          report();
          return (items[e] = take_frame(rig_, description_, clock_, v, e)).frame;
        });
    }
    const std::size_t first = record.bracket ? record.bracket->first : 0, last = record.bracket ? record.bracket->last : times.size() - 1;
    bool complete = true;
    for (std::size_t e = first; e <= last; ++e) complete &= items.contains(e);
    if (begun && !complete) go_to(v);
    for (std::size_t e = first; e <= last; ++e) record.exposures_s.push_back(times[e]);
    writer_.begin_view(std::move(record), begun != nullptr);
    for (std::size_t e = 0; e < times.size(); ++e) {
      const bool left_out = e < first || e > last;
      const auto item = items.find(e);
      if (rig_.frame_exists && (left_out || (item != items.end() && item->second.on_disk))) rig_.frame_exists(v, e);
      if (!left_out) writer_.push(item != items.end() ? std::move(item->second) : take_frame(rig_, description_, clock_, v, e));
      ++n_done_;
      report();
    }
  }

  Rig& rig_;
  const RigDescription& description_;
  const Session& session_;
  const JournalContent& journal_;
  const CaptureClock& clock_;
  const CaptureOptions& options_;
  FrameWriter& writer_;
  const Progress& progress_;
  std::optional<AdaptiveBracket> bracket_;
  std::size_t n_frames_ = 0, n_done_ = 0;
};

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
  PlanRunner(rig, description, session, journal, clock, options, writer, progress).run();
  writer.finish();
  write_session(session);
  lines.remove();
  return session;
}

}  // namespace lacquer::acquire
