#include <fmt/format.h>

#include <algorithm>

#include "libacquire/back_ends.h"
#include "libacquire/open_rig.h"
#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

template <typename Device, typename Settings>
std::unique_ptr<Device> open_with(std::span<const BackEnd<Device, Settings>> table, const std::string& name, const Settings& settings, const std::string& field) {
  std::string known;
  for (const auto& row : table) {
    if (row.name == name) {
      if (!row.open) throw Error(ErrorCode::usage, fmt::format("{}: \"{}\" is not in this build of Lacquer; configure it with -D{}=ON", field, name, row.option));
      return row.open(settings);
    }
    known += fmt::format("{}\"{}\"", known.empty() ? "" : ", ", row.name);
  }
  throw Error(ErrorCode::usage, fmt::format("{}: expected {}, got \"{}\"", field, known, name));
}

/// A plan that the devices cannot carry out is refused now, not after hours.
void check_plan(const RigDescription& description, const Rig& rig) {
  const std::string file = description.file.string();
  const TurntableLimits angles = rig.turntable->limits();
  const CameraLimits camera = rig.camera->limits();
  constexpr double degrees = 180 / 3.14159265358979323846, rounding = 1e-9;
  for (const PlannedView& view : description.plan) {
    if (view.turntable_angle < angles.min_angle - rounding || view.turntable_angle > angles.max_angle + rounding)
      throw Error(ErrorCode::usage, fmt::format("{}: plan.angles_deg: {:g} deg; {} turns from {:g} to {:g} deg", file, view.turntable_angle * degrees,
                                                rig.turntable->description(), angles.min_angle * degrees, angles.max_angle * degrees));
    for (const double exposure : view.exposures_s)
      if (exposure < camera.min_exposure_s * (1 - rounding) || exposure > camera.max_exposure_s * (1 + rounding))
        throw Error(ErrorCode::usage, fmt::format("{}: plan.exposures_ms: {:g} ms; {} takes {:g} to {:g} ms", file, exposure * 1e3, rig.camera->description(),
                                                  camera.min_exposure_s * 1e3, camera.max_exposure_s * 1e3));
  }
}

}  // namespace

Rig open_hardware_rig(const RigDescription& description) {
  const DevicesDescription& devices = description.devices;
  const std::string file = description.file.string();
  Rig rig;  // made safe if a later device cannot be opened
  rig.lights = open_with(lights_back_ends(), devices.lights_back_end, devices.lights, file + ": devices.lights.back_end");
  rig.camera = open_with(camera_back_ends(), devices.camera_back_end, devices.camera, file + ": devices.camera.back_end");
  rig.turntable = open_with(turntable_back_ends(), devices.turntable_back_end, devices.turntable, file + ": devices.turntable.back_end");
  if (rig.lights->n_lights() != static_cast<int>(description.geometry.lights.size()))
    throw Error(ErrorCode::usage, fmt::format("{}: devices.lights: {} lights, the rig has {}", file, rig.lights->n_lights(), description.geometry.lights.size()));
  check_plan(description, rig);
  return rig;
}

}  // namespace lacquer::acquire
