#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "libacquire/clock.h"
#include "libacquire/device_settings.h"
#include "libacquire/devices.h"
#include "libacquire/v4l2/v4l2_formats.h"
#include "libacquire/v4l2/video_device.h"

namespace lacquer::acquire {

/// A Video4Linux camera: mmap streaming, manual exposure and gain. Everything automatic that the camera has is switched off and read back.
/// The camera streams all the time, at its lowest frame rate so that long exposures fit between two frames. A frame counts as new if it was
/// exposed after capture() was called, by its time stamp; after a change of exposure `settle_frames` more are thrown away, for what is
/// still on its way through the camera. Gain is in the camera's own unit and fixed.
class V4l2Camera final : public Camera {
 public:
  /// `clock` must tell CLOCK_MONOTONIC, the clock of the time stamps. Throws Error {usage, device}.
  V4l2Camera(std::unique_ptr<VideoDevice> device, const CameraDeviceSettings& settings, Clock& clock = Clock::steady());
  ~V4l2Camera() override;
  std::string description() const override { return name_; }
  CameraLimits limits() const override { return limits_; }
  std::string warning() const override;

 private:
  struct Taken {
    std::uint32_t index = 0, sequence = 0, n_bytes = 0;
    bool damaged = false;
    std::optional<double> exposure_began;  ///< at the earliest, seconds of the clock; nullopt: no monotonic time stamps
  };
  RawFrame do_capture(const CaptureSettings& asked) override;

  void check_capabilities();
  void set_format();
  void set_lowest_frame_rate();
  void switch_automatics_off();
  void read_limits();
  void request_buffers();
  void set_exposure(double exposure_s);
  void stream(bool on);
  Taken take(double exposure_s);
  void give_back(std::uint32_t index);
  void empty_queue();

  /// Range and step of a control; nullopt: the camera does not have it.
  struct ControlRange {
    std::int32_t min, max, step, initial;
  };
  std::optional<ControlRange> control_range(std::uint32_t id);
  std::int32_t control_value(std::uint32_t id, const char* name);
  void set_control(std::uint32_t id, const char* name, std::int32_t value);
  void call(unsigned long request, void* argument, const char* doing);
  [[noreturn]] void fail(int error, const std::string& doing) const;

  std::unique_ptr<VideoDevice> device_;
  CameraDeviceSettings settings_;
  Clock& clock_;
  std::string name_;
  V4l2Format format_{};
  std::size_t stride_ = 0;
  double interval_s_ = 0.25;  ///< between two frames at most, and for the readout of one
  bool full_range_ = false;
  CameraLimits limits_;
  std::optional<ControlRange> exposure_range_;
  double exposure_s_ = 0;   ///< as read back
  bool changed_ = true;     ///< since the last frame
  bool streaming_ = false;
  std::vector<std::pair<const std::uint8_t*, std::size_t>> buffers_;
  std::optional<std::uint32_t> last_sequence_;
};

/// Opens `settings.id`: a device file, or the card's name or bus as `lacquer devices` prints them; empty: the only capture device.
std::unique_ptr<Camera> open_v4l2_camera(const CameraDeviceSettings& settings);

struct FoundV4l2Camera {
  std::string path, card, bus;
  std::vector<std::string> pixel_formats;  ///< "Y16  640x480, 320x240"
  std::optional<CameraLimits> limits;      ///< nullopt: no manual exposure
  std::string problem;                     ///< why it cannot be used; empty: it can
};

std::vector<FoundV4l2Camera> find_v4l2_cameras();

}  // namespace lacquer::acquire
