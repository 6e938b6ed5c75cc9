#pragma once

#include <optional>
#include <string>
#include <vector>

#include "libacquire/frame.h"

/// What a rig file says about real devices: which one, and how it is wired or geared. Plain data; rigs/README.md has the keys.
namespace lacquer::acquire {

/// A stepper turntable on a Pololu Tic. Angles are the table's, not the motor's.
struct TicSettings {
  std::string serial;                 ///< as printed by `lacquer devices`; empty: the only Tic
  int full_steps_per_turn = 200;      ///< of the motor
  int microsteps = 8;                 ///< per full step: 1, 2, 4 ... 256; what the controller model offers
  double gear_ratio = 1;              ///< motor turns per turn of the table
  std::optional<double> current_limit_a = {};  ///< of a coil; the controller's own steps, never above; nullopt: as set in the controller
  bool reversed = false;              ///< forward steps turn the table against the rig's right-handed sense
  double max_speed = 0.5;             ///< rad/s
  double max_acceleration = 0.5;      ///< rad/s^2, also for braking
  double backlash = 0;                ///< radians; every target is approached by forward steps over at least this angle
  double min_angle = -1e3, max_angle = 1e3;  ///< radians
  enum class Home { here, reverse, forward } home = Home::here;  ///< angle 0: where it stands at power-up, or a limit switch
  double home_angle = 0;              ///< radians, of the table at the limit switch
  double home_timeout_s = 120;
  double settle_s = 0.2;              ///< after a move, until nothing swings
};

/// One LED on one GPIO line.
struct GpioLightSettings {
  std::string chip;                   ///< name "gpiochip0", label, number or path
  std::string line;                   ///< name; empty: by offset
  unsigned offset = 0;
  bool active_low = false;
};

struct GpioSettings {
  std::vector<GpioLightSettings> lights;  ///< one per light of the rig
  double settle_s = 0.1;              ///< after switching on, until the light is steady
};

/// What a camera is to deliver, and what only its driver needs to know.
struct CameraDeviceSettings {
  int width = 0, height = 0;          ///< pixels, from the rig's [camera]; as are layout and bits
  PixelLayout layout = PixelLayout::mono;
  int bits = 8;
  std::string id = {};                ///< Aravis: id, serial number or address; V4L2: device file or card name; empty: the only one
  std::string pixel_format = {};      ///< GenICam name or V4L2 four-character code; empty: chosen from layout and bits
  int offset_x = 0, offset_y = 0;     ///< of the image on the sensor, pixels
  std::optional<double> gain = {};    ///< in the camera's own unit, fixed for the session; nullopt: the camera's smallest
  int packet_size = 0;                ///< GigE Vision, bytes; 0: 1400, which every network carries
  double timeout_s = 2;               ///< for a frame, beyond its exposure time
  std::optional<double> fixed_exposure_s = {};  ///< V4L2: of a camera whose exposure cannot be set
  int settle_frames = 2;              ///< V4L2: frames after a change of exposure that may still have the old one
};

/// [devices] of a rig file: which back end drives what. The names are those of the tables in back_ends.h.
struct DevicesDescription {
  std::string camera_back_end, turntable_back_end, lights_back_end;
  CameraDeviceSettings camera;
  TicSettings turntable;
  GpioSettings lights;
};

}  // namespace lacquer::acquire
