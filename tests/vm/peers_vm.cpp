#include "vm/peers_vm.h"

#include <atomic>
#include <cmath>
#include <cstdlib>
#include <numbers>

#include "libacquire/gpio/gpio_lights.h"
#include "libacquire/tic/tic_turntable.h"
#include "libacquire/tic/usb_tic.h"
#include "libacquire/v4l2/v4l2_camera.h"
#include "vm/gpio_sim.h"
#include "vm/usb_devices.h"

namespace lacquer::test {

namespace {

class UsbTicPeer final : public TurntablePeer {
 public:
  UsbTicPeer() {
    settings_.serial = "00123456";
    settings_.max_speed = 3;
    settings_.max_acceleration = 20;
    settings_.settle_s = 0.02;
    settings_.min_angle = -2;
    settings_.max_angle = 4;
    other_.plug_in();
    device_.plug_in();
  }
  std::unique_ptr<acquire::Turntable> open() override {
    return std::make_unique<acquire::TicTurntable>(when_there([&] { return acquire::open_usb_tic(settings_.serial); }), settings_);
  }
  double resolution() const override { return 2 * std::numbers::pi / 1600; }
  std::optional<double> physical_angle() override { return model_->physical_position() * resolution(); }
  std::optional<bool> energised() override { return model_->energised(); }
  bool unplug() override {
    device_.unplug();
    return true;
  }
  bool plug_in() override {
    device_.plug_in();
    return true;
  }
  bool jam() override {
    model_->set_jammed(true);
    return true;
  }

 private:
  acquire::TicSettings settings_;
  std::shared_ptr<TicModel> model_ = std::make_shared<TicModel>(acquire::Clock::steady());
  /// Another Tic on the same computer, which must not be taken.
  UsbTicDevice other_{std::make_shared<TicModel>(acquire::Clock::steady()), "00999999", 0x00C9, 0};
  UsbTicDevice device_{model_, "00123456", 0x00B3, 1};
};

class UvcPeer final : public CameraPeer {
 public:
  UvcPeer() {
    settings_.width = width();
    settings_.height = height();
    settings_.bits = 16;
    settings_.id = "Lacquer UVC camera";  // vivid is there too
    settings_.timeout_s = 3;
    device_.plug_in();
  }
  std::unique_ptr<acquire::Camera> open() override {
    return when_there([&] { return acquire::open_v4l2_camera(settings_); });
  }
  int width() const override { return UsbVideoDevice::width; }
  int height() const override { return UsbVideoDevice::height; }
  int bits() const override { return 16; }
  double expected_mean(double exposure_s) const override { return 256 + 300000 * exposure_s; }
  double tolerance() const override { return 1e-6; }
  std::vector<double> exposures_s() const override { return {0.001, 0.01, 0.1}; }
  std::optional<double> exposure_in_device() override { return device_.exposure_s(); }
  bool set_brightness(double factor) override {
    brightness_ = factor;
    return true;
  }
  bool stop_frames(bool stop) override {
    device_.stop_frames(stop);
    return true;
  }
  bool unplug() override {
    device_.unplug();
    return true;
  }
  bool plug_in() override {
    device_.plug_in();
    return true;
  }

 private:
  /// Two brightnesses in turn, 1 : 2, so that the mean does not hide a displaced image.
  unsigned count(int x, double exposure_s) const {
    return static_cast<unsigned>(std::lround(256 + brightness_ * (x % 2 == 0 ? 200000 : 400000) * exposure_s));
  }
  std::atomic<double> brightness_{1};
  acquire::CameraDeviceSettings settings_;
  UsbVideoDevice device_{[this](int x, int, double exposure_s) { return count(x, exposure_s); }, 2};
};

class GpioSimPeer final : public LightsPeer {
 public:
  GpioSimPeer() {
    for (const char* line : {"LED2", "LED3", ""}) lights_.push_back({.chip = GpioSim::label, .line = line, .offset = 5});  // the last by its number
  }
  std::unique_ptr<acquire::LightSwitch> open() override {
    return when_there([&] { return std::make_unique<acquire::GpioLights>(acquire::open_gpiod_lines(lights_), 0.01); });
  }
  int n_lights() const override { return 3; }
  std::optional<std::vector<bool>> shining() override {
    std::vector<bool> result;
    for (const unsigned line : {2u, 3u, 5u}) result.push_back(sim_.high(line));
    return result;
  }
  bool unplug() override {
    sim_.unplug();
    return true;
  }
  bool plug_in() override {
    sim_.plug_in();
    return true;
  }

 private:
  std::vector<acquire::GpioLightSettings> lights_;
  GpioSim sim_;
};

}  // namespace

bool in_virtual_machine() { return std::getenv("LACQUER_VM") != nullptr; }

void add_vm_peers(std::vector<PeerMaker<CameraPeer>>& list) {
  list.push_back({"UvcThroughTheKernel", [] { return std::make_unique<UvcPeer>(); }});
}
void add_vm_peers(std::vector<PeerMaker<TurntablePeer>>& list) {
  list.push_back({"TicThroughTheKernel", [] { return std::make_unique<UsbTicPeer>(); }});
}
void add_vm_peers(std::vector<PeerMaker<LightsPeer>>& list) {
  list.push_back({"GpioSim", [] { return std::make_unique<GpioSimPeer>(); }});
}

}  // namespace lacquer::test
