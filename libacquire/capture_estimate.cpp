#include "libacquire/capture_estimate.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "libacquire/sim/simulated_world.h"

namespace lacquer::acquire {

namespace {

constexpr double gige_bytes_per_s = 110e6;  // 1 Gbit/s less headers of packets of 1400 bytes
constexpr double trigger_s = 0.005;         // writing exposure time and trigger, reading both back
constexpr double video_period_s = 1.0 / 30;
constexpr std::uint64_t tiff_header_bytes = 512, tiff_row_bytes = 8;  // of write_frame, rounded up: each strip has two entries in a table

double turning_time(const RigDescription& rig, double from, double to) {
  if (from == to) return 0;
  switch (rig.kind) {
    case RigDescription::Kind::replay: return 0;
    case RigDescription::Kind::simulated:
      return sim::SimulatedTiming::per_move + sim::SimulatedTiming::per_radian * std::abs(to - from);
    case RigDescription::Kind::hardware: break;
  }
  const TicSettings& tic = rig.devices.turntable;
  if (rig.devices.turntable_back_end != "tic") return 0;
  const bool forward = (to > from) != tic.reversed;
  double time = tic.settle_s + move_duration(std::abs(to - from) + (forward ? 0 : tic.backlash), tic.max_speed, tic.max_acceleration);
  if (!forward && tic.backlash > 0) time += move_duration(tic.backlash, tic.max_speed, tic.max_acceleration);
  return time;
}

double switching_time(const RigDescription& rig) {
  switch (rig.kind) {
    case RigDescription::Kind::replay: return 0;
    case RigDescription::Kind::simulated: return sim::SimulatedTiming::per_switch;
    case RigDescription::Kind::hardware: return rig.devices.lights.settle_s;
  }
  return 0;
}

double readout_time(const RigDescription& rig, double exposure_s) {
  switch (rig.kind) {
    case RigDescription::Kind::replay: return 0;
    case RigDescription::Kind::simulated: return sim::SimulatedTiming::per_frame;
    case RigDescription::Kind::hardware: break;
  }
  const CameraDeviceSettings& camera = rig.devices.camera;
  if (rig.devices.camera_back_end == "v4l2") return (camera.settle_frames + 1) * std::max(exposure_s, video_period_s);
  const double bytes = static_cast<double>(camera.width) * camera.height * values_per_pixel(camera.layout) * (camera.bits > 8 ? 2 : 1);
  return trigger_s + bytes / gige_bytes_per_s;
}

}  // namespace

double move_duration(double angle, double max_speed, double max_acceleration) {
  const double ramps = max_speed * max_speed / max_acceleration;  // angle of both ramps of a move that reaches max_speed
  return angle >= ramps ? angle / max_speed + max_speed / max_acceleration : 2 * std::sqrt(angle / max_acceleration);
}

std::uint64_t frame_file_bytes(const RigDescription& rig) {
  const CameraModel& camera = rig.geometry.camera;
  const std::uint64_t values = static_cast<std::uint64_t>(camera.width) * static_cast<std::uint64_t>(camera.height) *
                               static_cast<std::uint64_t>(values_per_pixel(rig.sensor.layout));
  return tiff_header_bytes + tiff_row_bytes * static_cast<std::uint64_t>(camera.height) + values * (rig.sensor.bits == 8 ? 1 : 2);
}

double frame_duration(const RigDescription& rig, double exposure_s) {
  return rig.kind == RigDescription::Kind::replay ? 0 : exposure_s + readout_time(rig, exposure_s);
}

BracketSavings bracket_savings(const Session& session) {
  BracketSavings savings;
  std::size_t n_views = 0;
  for (std::size_t v = 0; v < session.views.size(); ++v) {
    const auto& bracket = session.views[v].bracket;
    if (!bracket) continue;
    const auto& planned = session.rig.plan[v].exposures_s;
    savings.n_planned += planned.size();
    for (std::size_t e = 0; e < planned.size(); ++e) {
      if (e >= bracket->first && e <= bracket->last) continue;
      ++savings.n_left_out;
      savings.seconds += frame_duration(session.rig, planned[e]);
    }
    savings.mean_loss += bracket->mean_loss;
    savings.largest_loss = std::max(savings.largest_loss, bracket->largest_loss);
    ++n_views;
  }
  if (n_views > 0) savings.mean_loss /= static_cast<double>(n_views);
  return savings;
}

CaptureEstimate estimate_capture(const RigDescription& rig) {
  CaptureEstimate estimate;
  double angle = 0;
  std::optional<int> light;
  for (const PlannedView& view : rig.plan) {
    estimate.motion_s += turning_time(rig, angle, view.turntable_angle);
    angle = view.turntable_angle;
    // The simulated clock counts every view's switching, whether or not the light was on already.
    if (light != view.light || rig.kind == RigDescription::Kind::simulated) estimate.lights_s += switching_time(rig);
    light = view.light;
    for (const double exposure : view.exposures_s) {
      if (rig.kind != RigDescription::Kind::replay) estimate.exposure_s += exposure;
      estimate.readout_s += readout_time(rig, exposure);
    }
    ++(view.kind == ViewKind::dark ? estimate.n_darks : view.kind == ViewKind::reference ? estimate.n_references : estimate.n_views);
    estimate.n_frames += view.exposures_s.size();
  }
  estimate.frame_bytes = estimate.n_frames * frame_file_bytes(rig);
  return estimate;
}

}  // namespace lacquer::acquire
