#include <linux/videodev2.h>

#include <cmath>

#include "conformance/fake_video_device.h"
#include "conformance/peer_lists.h"
#include "libacquire/v4l2/v4l2_camera.h"

namespace lacquer::test {

namespace {

/// The driver on a device in memory: a linear 16-bit sensor.
class FakeVideoPeer final : public CameraPeer {
 public:
  explicit FakeVideoPeer(bool monotonic) {
    video_->monotonic = monotonic;
    video_->fourccs = {V4L2_PIX_FMT_YUYV, V4L2_PIX_FMT_Y16};
    video_->controls = {{V4L2_CID_EXPOSURE_ABSOLUTE, {1, 10000, 1, 156}}, {V4L2_CID_EXPOSURE_AUTO, {0, 3, 1, 3}}};
    video_->sensor = [this](std::uint32_t, std::uint32_t width, std::uint32_t height, std::size_t stride, double exposure_s) {
      std::vector<std::uint8_t> bytes(stride * height);
      for (std::size_t y = 0; y < height; ++y)
        for (std::size_t x = 0; x < width; ++x) {
          const auto v = static_cast<unsigned>(std::lround(std::min(256 + brightness_ * rate(x) * exposure_s, 65535.0)));
          bytes[y * stride + 2 * x] = static_cast<std::uint8_t>(v & 255);
          bytes[y * stride + 2 * x + 1] = static_cast<std::uint8_t>(v >> 8);
        }
      return bytes;
    };
    settings_.width = width();
    settings_.height = height();
    settings_.bits = bits();
  }
  std::unique_ptr<acquire::Camera> open() override {
    return std::make_unique<acquire::V4l2Camera>(std::make_unique<FakeVideoDevice>(video_), settings_, video_->clock);
  }
  int width() const override { return 32; }
  int height() const override { return 8; }
  int bits() const override { return 16; }
  double expected_mean(double exposure_s) const override { return 256 + exposure_s * (rate(0) + rate(1)) / 2; }
  double tolerance() const override { return 1e-6; }
  std::vector<double> exposures_s() const override { return {0.001, 0.003, 0.01, 0.03, 0.1}; }
  std::optional<double> exposure_in_device() override { return video_->exposure_in_sensor(); }
  bool set_brightness(double factor) override {
    video_->run_to(video_->clock.now());  // what is being exposed now began before the change
    brightness_ = factor;
    return true;
  }
  bool stop_frames(bool stop) override {
    video_->dead = stop;
    return true;
  }
  bool unplug() override { return video_->unplugged = true; }
  bool plug_in() override {
    video_->unplugged = false;
    return true;
  }

 private:
  static double rate(std::size_t x) { return x % 2 == 0 ? 500000 : 200000; }  // counts per second
  double brightness_ = 1;
  acquire::CameraDeviceSettings settings_;
  std::shared_ptr<FakeVideo> video_ = std::make_shared<FakeVideo>();
};

}  // namespace

void add_v4l2_peers(std::vector<PeerMaker<CameraPeer>>& list) {
  list.push_back({"V4l2Fake", [] { return std::make_unique<FakeVideoPeer>(true); }});
  list.push_back({"V4l2FakeWithoutTimeStamps", [] { return std::make_unique<FakeVideoPeer>(false); }});
}

}  // namespace lacquer::test
