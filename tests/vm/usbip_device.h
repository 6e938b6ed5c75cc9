#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <thread>
#include <vector>

namespace lacquer::test {

/// A USB device in this process, plugged into the kernel's virtual host controller (vhci_hcd) over a socket pair with the USB/IP
/// protocol (Documentation/usb/usbip_protocol.rst). The kernel enumerates it like one on a cable. Needs root.
class UsbipDevice {
 public:
  struct Descriptors {
    std::vector<std::uint8_t> device, configuration;
    std::vector<std::string> strings;  ///< from index 1 on
    int speed = 2;                     ///< 2 full, 3 high
  };
  struct Setup {
    std::uint8_t request_type, request;
    std::uint16_t value, index, length;
  };

  UsbipDevice(Descriptors descriptors, int port) : descriptors_(std::move(descriptors)), port_(port) {}
  virtual ~UsbipDevice() { unplug(); }  // derived classes unplug before their members go
  UsbipDevice(const UsbipDevice&) = delete;
  UsbipDevice& operator=(const UsbipDevice&) = delete;

  /// Throws std::runtime_error where there is no vhci_hcd.
  void plug_in();
  void unplug();

 protected:
  /// Class and vendor requests. `data`: of an OUT transfer. Answer: data of an IN transfer; nullopt: stall.
  virtual std::optional<std::vector<std::uint8_t>> control(const Setup& setup, const std::vector<std::uint8_t>& data) = 0;
  /// Data for a bulk IN transfer of up to `length` bytes; nullopt: not yet, ask again soon.
  virtual std::optional<std::vector<std::uint8_t>> bulk_in(std::size_t /*length*/) { return std::nullopt; }

 private:
  struct Pending {
    std::uint32_t sequence, length;
  };
  void serve();
  bool serve_one();
  void answer_bulk();
  std::optional<std::vector<std::uint8_t>> standard(const Setup& setup) const;
  void reply(std::uint32_t sequence, bool in, std::int32_t status, const std::vector<std::uint8_t>& data, std::uint32_t n_out);

  Descriptors descriptors_;
  int port_;
  int socket_ = -1;
  std::atomic<bool> stop_{false};
  std::thread thread_;
  std::deque<Pending> pending_;
};

}  // namespace lacquer::test
