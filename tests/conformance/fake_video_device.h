#pragma once

#include <cstdint>
#include <array>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "conformance/turned_clock.h"
#include "libacquire/v4l2/video_device.h"

namespace lacquer::test {

/// A streaming camera as the kernel shows it: frames come one after the other into the buffers that are free, in the order given; when
/// none is free they are lost, so what waits in the queue is OLD. A new exposure shows `latency` frames after it was set. A frame shows
/// the scene at the START of its exposure and is stamped at its end.
struct FakeVideo {
  struct Control {
    std::int32_t min, max, step, value;
    bool sticks = true;  ///< false: takes every value and keeps its own
  };
  TurnedClock clock;
  std::uint32_t width = 32, height = 8;
  std::vector<std::uint32_t> fourccs;
  std::size_t extra_stride = 0;
  std::map<std::uint32_t, Control> controls;
  int latency = 2;
  bool monotonic = true, unplugged = false, dead = false, busy = false;
  std::size_t lost_bytes = 0;          ///< of each frame
  int n_damaged = 0;                   ///< of the next frames
  std::uint32_t capabilities = 0;      ///< 0: capture and streaming
  std::uint32_t quantization = 0;
  /// Bytes of a frame, all lines, `stride` bytes each.
  std::function<std::vector<std::uint8_t>(std::uint32_t fourcc, std::uint32_t width, std::uint32_t height, std::size_t stride, double exposure_s)> sensor;

  // State.
  std::uint32_t fourcc = 0;
  double interval_s = 1.0 / 30, next_frame_at = 0;
  std::deque<std::uint32_t> empty, filled;
  std::deque<double> exposures_on_their_way;
  std::vector<std::vector<std::uint8_t>> memory;
  std::vector<std::uint32_t> used, flags, sequence;
  std::vector<double> stamp;
  std::uint32_t n_frames = 0;
  std::vector<std::uint8_t> exposing;
  bool streaming = false;
  void expose_next();
  double exposure_in_sensor() const;

  std::size_t stride() const;
  void run_to(double time);
};

class FakeVideoDevice final : public acquire::VideoDevice {
 public:
  explicit FakeVideoDevice(std::shared_ptr<FakeVideo> video) : video_(std::move(video)) {}
  ~FakeVideoDevice() override;
  int control(unsigned long request, void* argument) override;
  const std::uint8_t* map(std::size_t length, std::int64_t offset) override;
  int wait(double seconds) override;
  std::string path() const override { return "/dev/fake"; }

 private:
  int handle(unsigned long request, void* argument);
  int handle_format(unsigned long request, void* argument);
  int handle_buffer(unsigned long request, void* argument);
  int handle_control(unsigned long request, void* argument);
  std::shared_ptr<FakeVideo> video_;
};

}  // namespace lacquer::test
