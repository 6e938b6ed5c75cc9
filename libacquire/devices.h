#pragma once

#include <memory>
#include <string>

#include "libacquire/frame.h"

namespace lacquer::acquire {

/// A camera. The public call checks before and after; the private one does the hardware.
class Camera {
 public:
  virtual ~Camera() = default;
  /// Blocks for one NEW frame (never a queued one); the settings in the frame are as read back. Throws Error {usage, device, timeout};
  /// usage: the exposure is not finite and > 0 or the gain is not finite; device: the back end returned an impossible frame.
  RawFrame capture(const CaptureSettings& asked);
  virtual std::string description() const = 0;  ///< model and serial number

 private:
  virtual RawFrame do_capture(const CaptureSettings& asked) = 0;
};

/// A turntable. Angles in radians, right-handed about the rig's y axis.
class Turntable {
 public:
  virtual ~Turntable() = default;
  /// Moves and waits until it stands; returns the angle read back. Throws Error {usage, device, timeout}.
  double move_to(double angle);
  /// Keeps the motor energised where it stands; called on every exit, never throws.
  virtual void hold() noexcept = 0;
  virtual std::string description() const = 0;

 private:
  virtual double do_move_to(double angle) = 0;
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

  Rig() = default;
  Rig(Rig&&) = default;
  Rig& operator=(Rig&& other) noexcept;
  ~Rig();

  /// Lights off, motor held; devices that are not there are skipped.
  void make_safe() noexcept;
};

}  // namespace lacquer::acquire
