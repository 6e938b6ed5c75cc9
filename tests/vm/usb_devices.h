#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <memory>

#include "conformance/tic_model.h"
#include "vm/usbip_device.h"

namespace lacquer::test {

/// The Tic of tic_model.h on a USB cable.
class UsbTicDevice final : public UsbipDevice {
 public:
  UsbTicDevice(std::shared_ptr<TicModel> model, const std::string& serial, std::uint16_t product, int port);
  ~UsbTicDevice() override { unplug(); }

 private:
  std::optional<std::vector<std::uint8_t>> control(const Setup& setup, const std::vector<std::uint8_t>& data) override;
  std::shared_ptr<TicModel> model_;
};

/// A USB Video Class 1.1 camera, 16-bit grey, bulk streaming, with manual exposure (100 us) and gain.
class UsbVideoDevice final : public UsbipDevice {
 public:
  static constexpr int width = 160, height = 120;
  /// Count of pixel (x, y) for an exposure.
  using Sensor = std::function<unsigned(int x, int y, double exposure_s)>;
  UsbVideoDevice(Sensor sensor, int port);
  ~UsbVideoDevice() override { unplug(); }
  double exposure_s() const { return exposure_ * 1e-4; }
  void stop_frames(bool stop) { frozen_ = stop; }

 private:
  std::optional<std::vector<std::uint8_t>> control(const Setup& setup, const std::vector<std::uint8_t>& data) override;
  std::optional<std::vector<std::uint8_t>> bulk_in(std::size_t length) override;
  std::optional<std::vector<std::uint8_t>> stream_control(const Setup& setup, const std::vector<std::uint8_t>& data);
  std::optional<std::vector<std::uint8_t>> number_control(const Setup& setup, const std::vector<std::uint8_t>& data, std::atomic<std::uint32_t>& value, std::size_t size,
                                                         std::uint32_t min, std::uint32_t max, std::uint32_t resolution);

  Sensor sensor_;
  std::atomic<std::uint32_t> exposure_{156}, gain_{0}, mode_{8};
  std::atomic<bool> frozen_{false};
  std::vector<std::uint8_t> image_;
  std::size_t sent_ = 0;
  bool odd_ = false;
  std::chrono::steady_clock::time_point next_frame_{};
};

}  // namespace lacquer::test
