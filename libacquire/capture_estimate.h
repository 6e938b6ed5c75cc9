#pragma once

#include <cstddef>
#include <cstdint>

#include "libacquire/rig_description.h"
#include "libacquire/session.h"

namespace lacquer::acquire {

/// What carrying out a plan will take, from the rig file alone; no device is opened. Of an adaptive bracket: the most it can take.
struct CaptureEstimate {
  std::size_t n_views = 0, n_references = 0, n_darks = 0;  ///< by kind: measurement, reference, dark
  std::size_t n_frames = 0;                                ///< of all of them
  double exposure_s = 0;  ///< shutter open for frames that are kept
  double readout_s = 0;   ///< transfer, and frames that a Video4Linux camera throws away after a change of exposure
  double lights_s = 0;    ///< until they are steady
  double motion_s = 0;    ///< of the turntable, settling included; homing is not
  std::uint64_t frame_bytes = 0;  ///< of all frame files

  double total_s() const { return exposure_s + readout_s + lights_s + motion_s; }
};

/// Simulated rigs: their simulated clock (exact), which is not the time the simulation takes. Hardware: speed, acceleration, backlash and
/// settling of the rig file; frames at 1 Gbit/s (GigE Vision), or settle_frames + 1 frame periods of at least 1/30 s (Video4Linux).
/// Replay: no time.
CaptureEstimate estimate_capture(const RigDescription& rig);

/// Exposure and readout of one frame, seconds; what estimate_capture counts for it. Replay: 0.
double frame_duration(const RigDescription& rig, double exposure_s);

/// What the adaptive brackets of a session left out of its plan, and what that costs.
struct BracketSavings {
  std::size_t n_planned = 0, n_left_out = 0;  ///< frames of the views with an adaptive bracket
  double seconds = 0;                         ///< frame_duration() of those left out
  double mean_loss = 0, largest_loss = 0;     ///< as BracketChoice: mean over the measurement and reference views, largest of all
};
BracketSavings bracket_savings(const Session& session);

/// Bytes of one frame file: uncompressed TIFF.
std::uint64_t frame_file_bytes(const RigDescription& rig);

/// Time for a move by `angle` (radians, >= 0) at constant acceleration and braking up to a largest speed, seconds.
double move_duration(double angle, double max_speed, double max_acceleration);

}  // namespace lacquer::acquire
