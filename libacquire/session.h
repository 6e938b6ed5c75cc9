#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "libacquire/devices.h"
#include "libacquire/rig_description.h"
#include "libbrdf/progress.h"

namespace lacquer::acquire {

struct FrameRecord {
  std::string file;       ///< relative to the session, e.g. "frames/L012_E03.tiff"
  double exposure_s = 0;  ///< read back
  std::string checksum;   ///< XXH3-128 of the file
};

struct ViewRecord {
  std::string id;              ///< "L012"
  double turntable_angle = 0;  ///< radians, read back
  int light = 0;
  std::vector<FrameRecord> frames;
};

/// session.json, written last and atomically. The rig file is kept beside it as rig.toml with its relative paths made absolute or copied.
struct Session {
  std::filesystem::path folder;
  RigDescription rig;
  std::vector<ViewRecord> views;
  std::string software;
  std::string command_line;

  std::filesystem::path frame_path(const FrameRecord& frame) const { return folder / frame.file; }
  std::filesystem::path radiance_path(const ViewRecord& view) const { return folder / "radiance" / (view.id + ".exr"); }
};

/// Reads SESSION/session.json and SESSION/rig.toml; Error{file} with the field.
Session read_session(const std::filesystem::path& folder);

/// Frame of a record, size, layout and checksum verified.
RawFrame read_session_frame(const Session& session, const FrameRecord& frame);

/// Called after every view with its frames still in memory (for merging while the table turns).
using ViewSink = std::function<void(const ViewRecord& view, const std::vector<RawFrame>& frames)>;

/// Runs the plan and writes frames, rig.toml and session.json into the new folder `folder` (an existing session is refused).
/// Lights off and motor held on every exit.
Session capture_session(Rig& rig, const RigDescription& description, const std::filesystem::path& folder,
                        const std::string& command_line, const Progress& progress, const ViewSink& sink = {});

}  // namespace lacquer::acquire
