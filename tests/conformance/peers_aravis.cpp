#include <atomic>
#include <cmath>

#include "conformance/fake_gige_camera.h"
#include "conformance/peer_lists.h"
#include "conformance/private_loopback.h"
#include "libacquire/aravis/aravis_camera.h"

namespace lacquer::test {

namespace {

/// Linear sensor: black level and a pattern of five brightnesses along each line, so that a value in a wrong place or bit is seen in the
/// mean of what follows it.
class AravisPeer final : public CameraPeer {
 public:
  AravisPeer(std::string format, acquire::PixelLayout layout, int bits, bool modern) : bits_(bits) {
    settings_ = {.width = 64, .height = 20, .layout = layout, .bits = bits, .id = "127.0.0.1", .pixel_format = std::move(format), .timeout_s = 0.4};
    camera_ = std::make_unique<FakeGigeCamera>([this](int x, int y, double exposure_s, double gain) { return count(x, y, exposure_s, gain); }, modern);
  }
  std::unique_ptr<acquire::Camera> open() override { return acquire::open_aravis_camera(settings_); }
  int width() const override { return settings_.width; }
  int height() const override { return settings_.height; }
  int bits() const override { return bits_; }
  bool set_brightness(double factor) override {
    brightness_ = factor;
    return true;
  }
  double expected_mean(double exposure_s) const override {
    double sum = 0;
    for (int y = 0; y < height(); ++y)
      for (int x = 0; x < width(); ++x) sum += black() + rate(x, y) * exposure_s;
    return sum / (width() * height());
  }
  double tolerance() const override { return 1e-6; }  // no noise; rounding to counts is allowed for by the suite
  std::vector<double> exposures_s() const override { return {0.001, 0.003, 0.010, 0.030, 0.100}; }
  std::optional<double> exposure_in_device() override { return camera_->exposure_in_device(); }
  bool unplug() override {
    if (bits_ != 8) return false;  // Aravis waits some 10 s in all for a camera that is gone; the same for every format
    camera_->unplug();
    return true;
  }
  bool plug_in() override {
    camera_->plug_in();
    return true;
  }
  bool stop_frames(bool stop) override {
    camera_->hold_triggers(stop);
    return true;
  }

 private:
  double full() const { return (1 << bits_) - 1; }
  double black() const { return full() / 64; }
  double rate(int x, int y) const { return full() * (1 + (x + y) % 5); }  // the brightest at half of full scale in 0.1 s
  unsigned count(int x, int y, double exposure_s, double gain) const {
    const double value = black() + brightness_ * rate(x, y) * exposure_s * std::pow(10, gain / 20);
    return static_cast<unsigned>(std::lround(std::min(value, full())));
  }

  int bits_;
  std::atomic<double> brightness_{1};
  acquire::CameraDeviceSettings settings_;
  std::unique_ptr<FakeGigeCamera> camera_;
};

}  // namespace

void add_loopback_peers(std::vector<PeerMaker<CameraPeer>>& list) {
  enter_private_loopback();
  using L = acquire::PixelLayout;
  const auto add = [&](const char* format, L layout, int bits, bool modern) {
    list.push_back({std::string("Aravis") + format, [=] { return std::make_unique<AravisPeer>(format, layout, bits, modern); }});
  };
  add("Mono8", L::mono, 8, false);
  add("Mono16", L::mono, 16, true);
  add("Mono12Packed", L::mono, 12, false);
  add("Mono10p", L::mono, 10, true);
  add("BayerRG12", L::bayer_rggb, 12, true);
}

}  // namespace lacquer::test
