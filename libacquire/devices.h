#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "libacquire/frame.h"

namespace lacquer::acquire {

/// What a camera can be asked for, as the device states it. A camera without limits of its own has those of a rig file.
struct CameraLimits {
  double min_exposure_s = 1e-9, max_exposure_s = 1e5;
  double min_gain_db = -100, max_gain_db = 100;
};

/// A camera. The public call checks before and after; the private one does the hardware.
class Camera {
 public:
  virtual ~Camera() = default;
  /// Blocks for one NEW frame (never a queued one); the settings in the frame are as read back. Throws Error {usage, device, timeout};
  /// usage: exposure or gain are no numbers or beyond limits(); device: the back end returned an impossible frame, or settings that
  /// are not those asked for (exposure off by more than 10 % and 0.2 ms, or gain by more than 1 dB: no camera rounds that far).
  RawFrame capture(const CaptureSettings& asked);
  virtual std::string description() const = 0;  ///< model and serial number
  virtual CameraLimits limits() const { return {}; }
  /// What somebody must know before trusting the photographs, e.g. that they are compressed; empty: nothing.
  virtual std::string warning() const { return {}; }

 private:
  virtual RawFrame do_capture(const CaptureSettings& asked) = 0;
};

/// Angles a turntable may be sent to, radians: what its cables and stops allow.
struct TurntableLimits {
  double min_angle = -1e9, max_angle = 1e9;
};

/// A turntable. Angles in radians, right-handed about the rig's y axis.
class Turntable {
 public:
  virtual ~Turntable() = default;
  /// Moves and waits until it stands; returns the angle read back. Throws Error {usage, device, timeout}; usage: not a number, or
  /// beyond limits().
  double move_to(double angle);
  /// Finds the reference that angle 0 is counted from, and stands there. A table whose angles are absolute has nothing to do.
  /// Throws Error {device, timeout}; the motor is then without current.
  void home();
  /// Stops if it moves and keeps the motor energised where it stands; called on every exit, never throws.
  virtual void hold() noexcept = 0;
  virtual TurntableLimits limits() const { return {}; }
  virtual std::string description() const = 0;

 private:
  virtual double do_move_to(double angle) = 0;
  virtual void do_home() {}
};

/// The lights of a rig: at most one is on.
class LightSwitch {
 public:
  virtual ~LightSwitch() = default;
  /// Switches light `index` on (all others off) and waits until it has settled. Throws Error {usage, device, timeout}.
  void on(int index);
  /// All off; called on every exit, never throws.
  virtual void off() noexcept = 0;
  virtual std::string description() const = 0;
  virtual int n_lights() const = 0;

 private:
  virtual void do_on(int index) = 0;
};

/// The devices of one rig. On destruction, and before other devices are moved in: lights off, motor held.
struct Rig {
  std::unique_ptr<Turntable> turntable;
  std::unique_ptr<LightSwitch> lights;
  std::unique_ptr<Camera> camera;
  /// Called instead of taking a frame of the plan that exists from an earlier, interrupted run, or that an adaptive bracket leaves out.
  /// Rigs that answer from memory or by a generator count it as taken; hardware needs nothing.
  std::function<void(std::size_t view, std::size_t exposure)> frame_exists;

  /// When the exposure of the last frame began, seconds since the capture did, of rigs that know better than the clock of this computer:
  /// simulated ones, and photographs, of which it is not known (nullopt).
  std::function<std::optional<double>()> frame_time;

  Rig() = default;
  Rig(Rig&&) = default;
  Rig& operator=(Rig&& other) noexcept;
  ~Rig();

  /// Lights off, motor held; devices that are not there are skipped.
  void make_safe() noexcept;
};

}  // namespace lacquer::acquire
