#include "libacquire/tic/usb_tic.h"

#include <fmt/format.h>
#include <libusb.h>

#include <algorithm>
#include <array>
#include <utility>

#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

constexpr std::uint16_t pololu = 0x1FFB;
constexpr std::array<std::pair<std::uint16_t, const char*>, 6> products{
    {{0x00B3, "T825"}, {0x00B5, "T834"}, {0x00BD, "T500"}, {0x00C3, "N825"}, {0x00C9, "T249"}, {0x00CB, "36v4"}}};
constexpr unsigned timeout_ms = 1000;  ///< a transfer takes about 1 ms

const char* product_name(const libusb_device_descriptor& d) {
  if (d.idVendor != pololu) return nullptr;
  const auto found = std::find_if(products.begin(), products.end(), [&](const auto& p) { return p.first == d.idProduct; });
  return found == products.end() ? nullptr : found->second;
}

struct CloseHandle {
  void operator()(libusb_device_handle* h) const { libusb_close(h); }
};
using Handle = std::unique_ptr<libusb_device_handle, CloseHandle>;

/// A libusb session of its own: handles must be closed before it.
class Usb {
 public:
  Usb() {
    if (const int error = libusb_init(&context_); error != 0)
      throw Error(ErrorCode::device, fmt::format("USB cannot be used: {}", libusb_strerror(static_cast<libusb_error>(error))));
  }
  Usb(const Usb&) = delete;
  Usb& operator=(const Usb&) = delete;
  ~Usb() { libusb_exit(context_); }

  /// Calls visit(device, product name) for every Tic.
  template <typename Visit>
  void for_each_tic(const Visit& visit) {
    libusb_device** list = nullptr;
    const auto n = libusb_get_device_list(context_, &list);
    if (n < 0) throw Error(ErrorCode::device, fmt::format("USB devices cannot be listed: {}", libusb_strerror(static_cast<libusb_error>(n))));
    const std::unique_ptr<libusb_device*, void (*)(libusb_device**)> owner(list, [](libusb_device** l) { libusb_free_device_list(l, 1); });
    for (ssize_t i = 0; i < n; ++i) {
      libusb_device_descriptor d{};
      if (libusb_get_device_descriptor(list[i], &d) != 0) continue;  // went away while being listed
      if (const char* name = product_name(d)) visit(list[i], d, name);
    }
  }

 private:
  libusb_context* context_ = nullptr;
};

std::string serial_of(libusb_device_handle* handle, const libusb_device_descriptor& d) {
  std::array<unsigned char, 256> text{};
  const int n = libusb_get_string_descriptor_ascii(handle, d.iSerialNumber, text.data(), static_cast<int>(text.size()));
  return n > 0 ? std::string(text.begin(), text.begin() + n) : std::string();
}

class UsbTic final : public ControlTransfers {
 public:
  UsbTic(std::unique_ptr<Usb> usb, Handle handle, std::string product, const std::string& serial)
      : usb_(std::move(usb)), handle_(std::move(handle)), product_(std::move(product)), name_(fmt::format("Tic {} {}", product_, serial)) {}

  void control_out(std::uint8_t request, std::uint16_t value, std::uint16_t index) override {
    check(libusb_control_transfer(handle_.get(), 0x40, request, value, index, nullptr, 0, timeout_ms), request, 0);
  }
  std::vector<std::uint8_t> control_in(std::uint8_t request, std::uint16_t value, std::uint16_t index, std::uint16_t length) override {
    std::vector<std::uint8_t> data(length);
    check(libusb_control_transfer(handle_.get(), 0xC0, request, value, index, data.data(), length, timeout_ms), request, length);
    return data;
  }
  std::string product() const override { return product_; }
  std::string name() const override { return name_; }

 private:
  void check(int result, unsigned request, int expected) const {
    if (result == expected) return;
    const char* const why = result >= 0                           ? "answered with too few bytes"
                            : result == LIBUSB_ERROR_NO_DEVICE    ? "was unplugged"
                            : result == LIBUSB_ERROR_PIPE         ? "refused the request (is its firmware current?)"
                            : result == LIBUSB_ERROR_TIMEOUT      ? "does not answer; unplug it and plug it in again"
                                                                  : libusb_strerror(static_cast<libusb_error>(result));
    throw Error(result == LIBUSB_ERROR_TIMEOUT ? ErrorCode::timeout : ErrorCode::device, fmt::format("{}: USB request 0x{:02X}: {}", name_, request, why));
  }

  std::unique_ptr<Usb> usb_;  // outlives handle_
  Handle handle_;
  std::string product_, name_;
};

}  // namespace

std::vector<FoundTic> find_usb_tics() {
  std::vector<FoundTic> found;
  Usb usb;
  usb.for_each_tic([&](libusb_device* device, const libusb_device_descriptor& d, const char* product) {
    libusb_device_handle* raw = nullptr;
    if (const int error = libusb_open(device, &raw); error != 0) {
      found.push_back({product, "", libusb_strerror(static_cast<libusb_error>(error))});
      return;
    }
    const Handle handle(raw);
    found.push_back({product, serial_of(raw, d), ""});
  });
  std::sort(found.begin(), found.end(), [](const FoundTic& a, const FoundTic& b) { return a.serial < b.serial; });
  return found;
}

std::unique_ptr<ControlTransfers> open_usb_tic(const std::string& serial) {
  auto usb = std::make_unique<Usb>();
  Handle handle;
  std::string product, serial_number, others, problem;
  int n_tics = 0, n_matching = 0;
  usb->for_each_tic([&](libusb_device* device, const libusb_device_descriptor& d, const char* its_product) {
    ++n_tics;
    libusb_device_handle* raw = nullptr;
    if (const int error = libusb_open(device, &raw); error != 0) {
      problem = fmt::format("a Tic {} cannot be opened: {} (udev rule: rigs/99-lacquer.rules)", its_product, libusb_strerror(static_cast<libusb_error>(error)));
      return;
    }
    Handle opened(raw);
    const std::string its_serial = serial_of(raw, d);
    others += (others.empty() ? "" : ", ") + its_serial;
    if (!serial.empty() && its_serial != serial) return;
    ++n_matching;
    handle = std::move(opened);
    product = its_product;
    serial_number = its_serial;
  });
  if (n_matching == 1) return std::make_unique<UsbTic>(std::move(usb), std::move(handle), std::move(product), serial_number);
  handle.reset();  // before its session
  if (n_matching > 1)
    throw Error(ErrorCode::device, fmt::format("{} Tics are connected ({}); devices.turntable.serial must say which", n_matching, others));
  if (!problem.empty()) throw Error(ErrorCode::device, problem);
  if (n_tics == 0) throw Error(ErrorCode::device, "no Pololu Tic is connected; check its USB cable (`lacquer devices` lists what is there)");
  throw Error(ErrorCode::device, fmt::format("no Tic has serial number {}; connected: {} (devices.turntable.serial)", serial, others));
}

}  // namespace lacquer::acquire
