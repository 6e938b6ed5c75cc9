#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <ostream>
#include <string>
#include <vector>

#include "libacquire/devices.h"

/// What a back end is tested against: the hardware's side of a device. One conformance suite per kind of device runs on every peer; a new
/// back end adds one peer to the list of its kind. What a peer cannot do (a simulated turntable has no plug), its test says it skips.
namespace lacquer::test {

class CameraPeer {
 public:
  virtual ~CameraPeer() = default;
  virtual std::unique_ptr<acquire::Camera> open() = 0;
  virtual int width() const = 0;
  virtual int height() const = 0;
  virtual int bits() const = 0;
  /// Light on the sensor; 1 as delivered.
  virtual bool set_brightness(double /*factor*/) { return false; }
  /// Mean count of a frame, not clipped, if brightness is 1.
  virtual double expected_mean(double exposure_s) const = 0;
  virtual double tolerance() const { return 0.02; }  ///< of expected_mean, relative: noise and rounding of this sensor
  virtual std::vector<double> exposures_s() const = 0;  ///< some that the camera can do, none of them clipped
  virtual std::optional<double> exposure_in_device() { return std::nullopt; }
  virtual bool unplug() { return false; }
  virtual bool plug_in() { return false; }
  /// Answers, but delivers no frames.
  virtual bool stop_frames(bool /*stop*/) { return false; }
};

class TurntablePeer {
 public:
  virtual ~TurntablePeer() = default;
  virtual std::unique_ptr<acquire::Turntable> open() = 0;
  virtual double resolution() const = 0;  ///< radians
  virtual std::optional<double> physical_angle() { return std::nullopt; }
  virtual std::optional<bool> energised() { return std::nullopt; }
  virtual bool unplug() { return false; }
  virtual bool plug_in() { return false; }
  virtual bool jam() { return false; }
};

class LightsPeer {
 public:
  virtual ~LightsPeer() = default;
  virtual std::unique_ptr<acquire::LightSwitch> open() = 0;
  virtual int n_lights() const = 0;
  /// Which lights shine now, seen from outside; nullopt: cannot be seen once the switch is closed.
  virtual std::optional<std::vector<bool>> shining() = 0;
  /// More than one shone at some moment.
  virtual bool two_shone() { return false; }
  virtual bool unplug() { return false; }
  virtual bool plug_in() { return false; }
};

template <typename Peer>
struct PeerMaker {
  std::string name;  ///< letters and digits: part of the test's name
  std::function<std::unique_ptr<Peer>()> make;
};

template <typename Peer>
void PrintTo(const PeerMaker<Peer>& maker, std::ostream* out) {
  *out << maker.name;
}

/// Peers that this machine has. Inside the virtual machine (LACQUER_VM=1): those of its kernel; else: those in process and on loopback.
std::vector<PeerMaker<CameraPeer>> camera_peers();
std::vector<PeerMaker<TurntablePeer>> turntable_peers();
std::vector<PeerMaker<LightsPeer>> lights_peers();

}  // namespace lacquer::test
