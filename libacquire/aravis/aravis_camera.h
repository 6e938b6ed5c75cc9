#pragma once

#include <memory>
#include <string>
#include <vector>

#include "libacquire/device_settings.h"
#include "libacquire/devices.h"

/// GigE Vision and USB3 Vision cameras through Aravis 0.8.
namespace lacquer::acquire {

/// Opens and configures a camera: region, pixel format, automatics off (read back), software trigger. Cameras without a software trigger
/// start and stop for every frame. Incomplete frames are asked for again, at most 5 times; after a frame that did not come in time the
/// camera is stopped and emptied, so that it cannot pass for the next one. Region, format and exposure of every frame are verified
/// against what the device says. Gain: 0 dB is the gain of `settings`; other values only where the camera's unit is dB (feature Gain).
/// Throws Error {usage, device, timeout}.
std::unique_ptr<Camera> open_aravis_camera(const CameraDeviceSettings& settings);

struct FoundAravisCamera {
  std::string id, vendor, model, serial, address, protocol;
  std::vector<std::string> pixel_formats;
  int width = 0, height = 0;  ///< of the sensor
  CameraLimits limits;
  std::string problem;        ///< why it cannot be opened; empty: it can
};

/// Asks the network and USB (takes about a second), opens each camera shortly.
std::vector<FoundAravisCamera> find_aravis_cameras();

}  // namespace lacquer::acquire
