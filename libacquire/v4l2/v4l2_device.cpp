#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>
#include <utility>
#include <vector>

#include "libacquire/v4l2/video_device.h"
#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

class KernelVideoDevice final : public VideoDevice {
 public:
  explicit KernelVideoDevice(const std::string& path) : path_(path), fd_(open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC)) {
    if (fd_ >= 0) return;
    const char* const why = errno == EACCES || errno == EPERM ? "not allowed; add yourself to the group video"
                            : errno == ENOENT || errno == ENODEV || errno == ENXIO ? "no such camera (`lacquer devices` lists what is there)"
                            : errno == EBUSY ? "in use by another program"
                                             : std::strerror(errno);
    throw Error(ErrorCode::device, path + ": " + why);
  }
  KernelVideoDevice(const KernelVideoDevice&) = delete;
  KernelVideoDevice& operator=(const KernelVideoDevice&) = delete;
  ~KernelVideoDevice() override {
    for (const auto& [address, length] : mapped_) munmap(address, length);
    close(fd_);
  }

  int control(unsigned long request, void* argument) override {
    int result = 0;
    do result = ioctl(fd_, request, argument);
    while (result == -1 && errno == EINTR);
    return result == -1 ? errno : 0;
  }
  const std::uint8_t* map(std::size_t length, std::int64_t offset) override {
    void* const address = mmap(nullptr, length, PROT_READ | PROT_WRITE, MAP_SHARED, fd_, offset);
    if (address == MAP_FAILED) return nullptr;
    mapped_.emplace_back(address, length);
    return static_cast<const std::uint8_t*>(address);
  }
  int wait(double seconds) override {
    using Clock = std::chrono::steady_clock;
    const auto deadline = Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(seconds));
    while (true) {
      const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now()).count();
      pollfd p{fd_, POLLIN, 0};
      const int n = poll(&p, 1, static_cast<int>(std::max<long>(left, 0)));
      if (n > 0) return p.revents & POLLIN ? 0 : ENODEV;  // POLLERR: the stream is off or the camera is gone
      if (n < 0 && errno != EINTR) return errno;
      if (n == 0 && left <= 0) return ETIMEDOUT;
    }
  }
  std::string path() const override { return path_; }

 private:
  std::string path_;
  int fd_;
  std::vector<std::pair<void*, std::size_t>> mapped_;
};

}  // namespace

std::unique_ptr<VideoDevice> open_video_device(const std::string& path) { return std::make_unique<KernelVideoDevice>(path); }

}  // namespace lacquer::acquire
