#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

namespace lacquer::acquire {

/// An opened /dev/video*: the four system calls that a V4L2 driver needs.
class VideoDevice {
 public:
  virtual ~VideoDevice() = default;
  /// ioctl, repeated when a signal interrupts it. 0, or an errno.
  virtual int control(unsigned long request, void* argument) = 0;
  /// Shared memory of one buffer, nullptr if it cannot be had; unmapped with the device.
  virtual const std::uint8_t* map(std::size_t length, std::int64_t offset) = 0;
  /// Waits until a filled buffer can be taken. 0: it can; ETIMEDOUT; another errno.
  virtual int wait(double seconds) = 0;
  virtual std::string path() const = 0;
};

/// Throws Error{device}: not there, not allowed, in use.
std::unique_ptr<VideoDevice> open_video_device(const std::string& path);

}  // namespace lacquer::acquire
