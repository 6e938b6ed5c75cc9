#include <numbers>
#include <numeric>

#include "conformance/fake_gpio_lines.h"
#include "conformance/peer_lists.h"
#include "conformance/tic_model.h"
#include "conformance/turned_clock.h"
#include "libacquire/gpio/gpio_lights.h"
#include "libacquire/open_rig.h"
#include "libacquire/tic/tic_turntable.h"

namespace lacquer::test {

namespace {

constexpr double degree = std::numbers::pi / 180;

/// A matt white sphere, small and quickly rendered.
class White final : public brdf::Brdf {
 public:
  std::string description() const override { return "white"; }

 private:
  std::optional<glm::dvec3> do_value(const brdf::Directions&, const brdf::Footprint<double>&) const override { return glm::dvec3(0.2); }
};

acquire::RigDescription small_rig() {
  return acquire::parse_rig(R"(
[rig]
name = "small"
kind = "simulated"
[camera]
width_px = 48
height_px = 36
layout = "mono"
bits = 12
focal_length_px = 305
position_mm = [0, 0, 1000]
[sensor]
black_level_dn = 64
gain_e_per_dn = 4.2
sensitivity_e_per_s = 5e5
[[lights]]
name = "weak"
position_mm = [0, 0, 600]
intensity = 0.2
[[lights]]
name = "middle"
position_mm = [0, 0, 600]
intensity = 0.4
[[lights]]
name = "strong"
position_mm = [0, 0, 600]
intensity = 0.6
[plan]
angles_deg = [0]
exposures_ms = [1]
)", "small.toml");
}

acquire::Rig open_small_rig() { return acquire::open_simulated_rig(small_rig(), std::make_shared<White>()); }

double mean_of(const acquire::RawFrame& frame) {
  return std::accumulate(frame.data.begin(), frame.data.end(), 0.0) / static_cast<double>(frame.data.size());
}

/// The devices of a rig live together: one of them, holding the others.
class CameraOfRig final : public acquire::Camera {
 public:
  explicit CameraOfRig(acquire::Rig rig) : rig_(std::move(rig)) { rig_.lights->on(2); }
  std::string description() const override { return rig_.camera->description(); }
  acquire::CameraLimits limits() const override { return rig_.camera->limits(); }

 private:
  acquire::RawFrame do_capture(const acquire::CaptureSettings& asked) override { return rig_.camera->capture(asked); }
  acquire::Rig rig_;
};

class SimulatedCameraPeer final : public CameraPeer {
 public:
  SimulatedCameraPeer() { reference_ = mean_of(open()->capture({0.03, 0})); }
  std::unique_ptr<acquire::Camera> open() override { return std::make_unique<CameraOfRig>(open_small_rig()); }
  int width() const override { return 48; }
  int height() const override { return 36; }
  int bits() const override { return 12; }
  double expected_mean(double exposure_s) const override { return 64 + (reference_ - 64) * exposure_s / 0.03; }
  std::vector<double> exposures_s() const override { return {0.005, 0.01, 0.02, 0.04}; }

 private:
  double reference_ = 0;
};

class SimulatedTurntablePeer final : public TurntablePeer {
 public:
  std::unique_ptr<acquire::Turntable> open() override { return std::move(open_small_rig().turntable); }
  double resolution() const override { return 1e-12; }
};

/// Three lights in one place, 1 : 2 : 3 in strength; the camera tells them apart.
class SimulatedLightsPeer final : public LightsPeer {
 public:
  std::unique_ptr<acquire::LightSwitch> open() override {
    acquire::Rig rig = open_small_rig();
    camera_ = std::move(rig.camera);
    return std::move(rig.lights);
  }
  int n_lights() const override { return 3; }
  std::optional<std::vector<bool>> shining() override {
    const double light = mean_of(camera_->capture({0.03, 0})) - 64;
    std::vector<bool> result(3, false);
    if (unit_ == 0 && light > 1) unit_ = light;  // the first to be switched on is the weakest
    if (light > 1) result.at(static_cast<std::size_t>(std::lround(light / unit_)) - 1) = true;
    return result;
  }

 private:
  std::unique_ptr<acquire::Camera> camera_;
  double unit_ = 0;
};

class TicModelPeer final : public TurntablePeer {
 public:
  explicit TicModelPeer(acquire::TicSettings settings) : settings_(std::move(settings)) { settings_.min_angle = -2, settings_.max_angle = 4; }
  std::unique_ptr<acquire::Turntable> open() override {
    return std::make_unique<acquire::TicTurntable>(std::make_unique<ModelTransfers>(model_, faults_), settings_, clock_);
  }
  double resolution() const override { return 2 * std::numbers::pi / steps_per_turn(); }
  std::optional<double> physical_angle() override {
    return model_->physical_position() * resolution() * (settings_.reversed ? -1 : 1);
  }
  std::optional<bool> energised() override { return model_->energised(); }
  bool unplug() override { return faults_->unplugged = true; }
  bool plug_in() override {
    faults_->unplugged = false;
    return true;
  }
  bool jam() override {
    model_->set_jammed(true);
    return true;
  }

 private:
  double steps_per_turn() const { return settings_.full_steps_per_turn * settings_.microsteps * settings_.gear_ratio; }
  TurnedClock clock_;
  acquire::TicSettings settings_;
  std::shared_ptr<TicModel> model_ = std::make_shared<TicModel>(clock_);
  std::shared_ptr<ModelTransfers::Faults> faults_ = std::make_shared<ModelTransfers::Faults>();
};

acquire::TicSettings geared() {
  acquire::TicSettings s;
  s.gear_ratio = 9.75;
  s.microsteps = 16;
  s.reversed = true;
  s.backlash = 1.5 * degree;
  return s;
}

class FakeGpioPeer final : public LightsPeer {
 public:
  std::unique_ptr<acquire::LightSwitch> open() override {
    return std::make_unique<acquire::GpioLights>(std::make_unique<FakeGpioLines>(wires_), 0.1, clock_);
  }
  int n_lights() const override { return 3; }
  std::optional<std::vector<bool>> shining() override { return wires_->on; }
  bool two_shone() override { return wires_->two_were_on; }
  bool unplug() override { return wires_->unplugged = true; }
  bool plug_in() override {
    wires_->unplugged = false;
    return true;
  }

 private:
  TurnedClock clock_;
  std::shared_ptr<FakeWires> wires_ = std::make_shared<FakeWires>(3);
};

}  // namespace

void add_in_process_peers(std::vector<PeerMaker<CameraPeer>>& list) {
  list.push_back({"Simulated", [] { return std::make_unique<SimulatedCameraPeer>(); }});
}

void add_in_process_peers(std::vector<PeerMaker<TurntablePeer>>& list) {
  list.push_back({"Simulated", [] { return std::make_unique<SimulatedTurntablePeer>(); }});
  list.push_back({"TicModel", [] { return std::make_unique<TicModelPeer>(acquire::TicSettings{}); }});
  list.push_back({"TicModelGeared", [] { return std::make_unique<TicModelPeer>(geared()); }});
}

void add_in_process_peers(std::vector<PeerMaker<LightsPeer>>& list) {
  list.push_back({"Simulated", [] { return std::make_unique<SimulatedLightsPeer>(); }});
  list.push_back({"FakeGpio", [] { return std::make_unique<FakeGpioPeer>(); }});
}

}  // namespace lacquer::test
