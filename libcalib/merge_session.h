#pragma once

#include <filesystem>
#include <future>
#include <optional>
#include <vector>

#include "libacquire/session.h"
#include "libbrdf/progress.h"
#include "libcalib/calibration.h"
#include "libcalib/drift_session.h"
#include "libcalib/merge.h"

namespace lacquer::calib {

/// What is known of the sensor before a session's frames are merged: the rig file, corrected by the session's dark views; where the rig
/// file asks for it response and noise are estimated from the brackets of a few views spread over the session (the scale then becomes
/// relative unless the response turns out linear: the gauge of an estimated curve is not the sensitivity that the rig file states).
/// May write SESSION/maps.exr.
Calibration sensor_calibration(const acquire::Session& session, const Progress& progress = {});

/// Does sensor_calibration() need the captured frames? If not, frames can be merged as they come, with calibration_from_rig().
bool sensor_needs_session(const acquire::RigDescription& rig);

/// What an adaptive bracket predicts with.
acquire::SensorNoise bracket_noise(const Calibration& calibration);

/// Merges the frames of a session, as they come or from its files, into SESSION/radiance/<view>.exr and follows the lights meanwhile.
class SessionMerger {
 public:
  /// `calibration`: response, noise and maps are used; must outlive the merger.
  SessionMerger(const acquire::RigDescription& rig, std::filesystem::path folder, const Calibration& calibration);

  /// Next frame of a view, in the order of the plan; view.exposures_s says how many there will be. Dark views: ignored.
  void add(const acquire::ViewRecord& view, const acquire::RawFrame& frame);
  /// All frames of the view are there. Its file is written while the next view is merged; what goes wrong is thrown by the next call.
  void finish_view(const acquire::ViewRecord& view);
  /// All views are merged and written: what the lights did goes into `calibration`.
  void finish(Calibration& calibration);

 private:
  const Calibration& calibration_;
  std::filesystem::path folder_;
  LightFollower follower_;
  std::optional<BracketMerger> merger_;
  std::vector<double> times_;
  std::future<void> writing_;
};

/// All of it from the files of a session, a few frames in memory at a time; sets light_drift and drift_source of `calibration`.
void merge_session(const acquire::Session& session, Calibration& calibration, const Progress& progress);

}  // namespace lacquer::calib
