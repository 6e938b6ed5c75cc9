#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "libacquire/device_settings.h"
#include "libacquire/devices.h"

/// The tables of back ends: one row per way to drive a device. A new back end is a driver, a row here, and a peer of the conformance suite
/// (docs/add-a-camera.md). Rows of back ends that this build does not have stay, so that the message can say so.
namespace lacquer::acquire {

/// One device as `lacquer devices` shows it.
struct FoundDevice {
  std::string id;                      ///< what a rig file calls it
  std::string description;
  std::vector<std::string> formats;    ///< of a camera: pixel formats; of a GPIO chip: its named lines
  std::optional<CameraLimits> limits;  ///< of a camera whose exposure can be set
  std::string problem;                 ///< why it cannot be used now; empty: it can
};

template <typename Device, typename Settings>
struct BackEnd {
  std::string_view name;    ///< back_end = "..." in a rig file
  std::string_view option;  ///< of CMake
  std::unique_ptr<Device> (*open)(const Settings& settings);  ///< nullptr: not in this build
  std::vector<FoundDevice> (*find)();                         ///< nullptr: nothing to look for
};

std::span<const BackEnd<Camera, CameraDeviceSettings>> camera_back_ends();
std::span<const BackEnd<Turntable, TicSettings>> turntable_back_ends();
std::span<const BackEnd<LightSwitch, GpioSettings>> lights_back_ends();

}  // namespace lacquer::acquire
