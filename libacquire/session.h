#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "libacquire/devices.h"
#include "libacquire/rig_description.h"
#include "libbrdf/progress.h"

namespace lacquer::acquire {

struct FrameRecord {
  std::string file;       ///< relative to the session, e.g. "frames/L012_E03.tiff"
  double exposure_s = 0;  ///< read back
  double gain_db = 0;     ///< read back
  std::string checksum;   ///< XXH3-128 of the file
  std::string source;     ///< replay: the photograph it was made from; else empty
  std::optional<double> time_s;  ///< when the exposure began, seconds since the capture did; photographs: not known
};

/// Which exposures of the plan an adaptive bracket takes, and what leaving out the others costs, as the noise model predicts it.
struct BracketChoice {
  std::size_t first = 0, last = 0;  ///< of PlannedView::exposures_s
  double mean_loss = 0;             ///< sigma of a merged value over that of the full bracket, minus 1: mean over the lit paint
  double largest_loss = 0;          ///< and largest
};

struct ViewRecord {
  std::string id;              ///< "L012", as planned
  double turntable_angle = 0;  ///< radians, read back
  int light = 0;               ///< -1: dark
  ViewKind kind = ViewKind::measurement;
  std::vector<double> exposures_s = {};  ///< as planned, of the frames that this view has when it is complete; ascending
  std::optional<BracketChoice> bracket = {};  ///< nullopt: all that were planned
  std::vector<FrameRecord> frames = {};

  /// Mean time of the middle of its exposures; nullopt where one is not known.
  std::optional<double> time_s() const;
};

/// A captured session. session.json is written last and atomically: a folder without it is not a session. Beside it lie rig.toml, the
/// rig file as it was with a table [copied_files] at its end, and rig/, copies of the mask and light tables it refers to; their checksums
/// are in session.json, so a session can be moved and is read without the files it was made from.
struct Session {
  std::filesystem::path folder;
  RigDescription rig;     ///< rig.simulation.paint: the paint that was photographed, absolute; empty for real photographs
  std::vector<ViewRecord> views;
  std::map<std::string, std::string> rig_files;  ///< rig.toml and its copied files, relative to the session -> checksum
  std::string software;
  std::string command_line;

  /// Indices of the views of a kind, ascending.
  std::vector<std::size_t> views_of(ViewKind kind) const;
  std::filesystem::path frame_path(const FrameRecord& frame) const { return folder / frame.file; }
  std::filesystem::path radiance_path(const ViewRecord& view) const { return folder / "radiance" / (view.id + ".exr"); }
};

/// Reads SESSION/session.json and SESSION/rig.toml; Error{file} with the field. Names of files that lead out of the session are refused.
Session read_session(const std::filesystem::path& folder);

/// Writes session.json; `session.views` are the first views of session.rig.plan.
void write_session(const Session& session);

/// Frame of a record, size, layout and checksum verified.
RawFrame read_session_frame(const Session& session, const FrameRecord& frame);

/// Size, layout and bits are those of the rig; else Error{file}, beginning with `name`.
void check_format(const RawFrame& frame, const RigDescription& rig, const std::string& name);

/// Where the frame of an exposure of a view lies in the session: "frames/L012_E03.tiff".
std::string frame_name(const std::string& view_id, std::size_t exposure);

/// What becomes of the frames as they come. Called on one thread of the capture's own, in the order of the plan, so that the next frame is
/// exposed meanwhile; the short exposures of a bracket come faster than they are written, so some wait: as many as
/// `max_waiting_bytes` hold, and `min_waiting_frames` whatever their size. An exception ends the capture as any other failure does.
struct FrameSink {
  /// A frame is safely on disk: written, checksummed, renamed, recorded. `view.frames` ends with it.
  std::function<void(const ViewRecord& view, const RawFrame& frame)> frame;
  /// All frames of the view were handed over.
  std::function<void(const ViewRecord& view)> view;
};
constexpr std::size_t min_waiting_frames = 4;
constexpr std::size_t max_waiting_bytes = std::size_t{64} << 20;

/// Noise of a value as an adaptive bracket predicts it, DN of a linear sensor.
struct SensorNoise {
  double black_level_dn = 0;
  double saturation_dn = 0;   ///< raw values >= this are clipped
  double gain_e_per_dn = 1;
  double read_noise_e = 2;    ///< RMS
  double relative_noise = 0;  ///< RMS fraction of the signal
};

struct CaptureOptions {
  std::string command_line;
  /// Goes on with a capture that was interrupted: same rig file, same folder. Frames that are on disk and have the recorded checksum are
  /// kept and handed to the sink as if they had just come; the others are taken. Nothing there yet: begins. Complete already: only reads.
  bool resume = false;
  /// Called once when the folder is ready, before the first frame: checks of the devices. What it throws ends the capture there.
  std::function<void(Rig&)> before_frames = {};
  /// Called before a view of which frames have to be taken, before anything moves. What it throws ends the capture there.
  std::function<void(std::size_t view)> before_view = {};
  /// Rigs with an adaptive bracket need it.
  std::optional<SensorNoise> noise = {};
};

/// Runs the plan and writes frames, rig.toml and session.json into `folder`, which must be new or empty unless options.resume.
/// Lights off and motor held on every exit. After an exception (also Error{interrupted} from `progress`, called after every frame)
/// the frames taken so far stay on disk, recorded in capture.jsonl, and the capture can be resumed; session.json is written last.
Session capture_session(Rig& rig, const RigDescription& description, const std::filesystem::path& folder, const CaptureOptions& options,
                        const Progress& progress, const FrameSink& sink = {});

}  // namespace lacquer::acquire
