#pragma once

#include <filesystem>
#include <functional>
#include <map>
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
};

struct ViewRecord {
  std::string id;              ///< "L012"
  double turntable_angle = 0;  ///< radians, read back
  int light = 0;
  std::vector<FrameRecord> frames;
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

/// Called after every view with its frames still in memory (for merging while the table turns), on the calling thread, in the order of
/// the plan, when the frames of the view are safely on disk.
using ViewSink = std::function<void(const ViewRecord& view, const std::vector<RawFrame>& frames)>;

/// Runs the plan and writes frames, rig.toml and session.json into `folder`, which must be new or empty.
/// While a view is captured, the frames of the one before are written. Lights off and motor held on every exit. After an exception
/// (also Error{interrupted} from `progress`) the frames written so far stay on disk; session.json is not written.
Session capture_session(Rig& rig, const RigDescription& description, const std::filesystem::path& folder,
                        const std::string& command_line, const Progress& progress, const ViewSink& sink = {});

}  // namespace lacquer::acquire
