#include "vm/usb_devices.h"

#include <algorithm>

namespace lacquer::test {

namespace {

using Bytes = std::vector<std::uint8_t>;

std::uint8_t low(unsigned v) { return static_cast<std::uint8_t>(v & 255); }
std::uint8_t high(unsigned v) { return static_cast<std::uint8_t>(v >> 8 & 255); }

void append(Bytes& to, std::initializer_list<unsigned> bytes) {
  for (const unsigned b : bytes) to.push_back(low(b));
}
void append_u32(Bytes& to, std::uint32_t v) { append(to, {v, v >> 8, v >> 16, v >> 24}); }

UsbipDevice::Descriptors tic_descriptors(const std::string& serial, std::uint16_t product) {
  UsbipDevice::Descriptors d;
  append(d.device, {18, 1, 0x00, 0x02, 0xFF, 0, 0, 8, 0xFB, 0x1F, low(product), high(product), 0x06, 0x01, 1, 2, 3, 1});
  append(d.configuration, {9, 2, 18, 0, 1, 1, 0, 0xC0, 50, /* interface */ 9, 4, 0, 0, 0, 0xFF, 0, 0, 0});
  d.strings = {"Pololu Corporation", "Tic", serial};
  d.speed = 2;
  return d;
}

constexpr std::uint32_t payload_bytes = 16384, header_bytes = 12;
constexpr std::uint32_t image_bytes = UsbVideoDevice::width * UsbVideoDevice::height * 2;
constexpr std::uint32_t frame_interval = 666666;  // 100 ns: 15 frames a second
constexpr unsigned camera_terminal = 1, processing_unit = 2, output_terminal = 3;

/// Universal Serial Bus Device Class Definition for Video Devices 1.1, sections 3.5 to 3.9.
UsbipDevice::Descriptors video_descriptors() {
  UsbipDevice::Descriptors d;
  append(d.device, {18, 1, 0x00, 0x02, 0xEF, 2, 1, 64, 0x6B, 0x1D, 0x02, 0x01, 0x00, 0x01, 1, 2, 3, 1});
  Bytes control;  // class-specific part of the control interface
  append(control, {13, 0x24, 1, 0x10, 0x01, 0, 0, 0x80, 0x8D, 0x5B, 0x00, 1, 1});                                       // header; total length follows below
  append(control, {18, 0x24, 2, camera_terminal, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x0A, 0, 0});                   // auto exposure mode, exposure time
  append(control, {12, 0x24, 5, processing_unit, camera_terminal, 0, 0, 3, 0x00, 0x02, 0, 0});                          // gain
  append(control, {9, 0x24, 3, output_terminal, 0x01, 0x01, 0, processing_unit, 0});
  control[5] = low(static_cast<unsigned>(control.size()));
  control[6] = high(static_cast<unsigned>(control.size()));
  Bytes stream;
  append(stream, {14, 0x24, 1, 1, 0, 0, 0x81, 0, output_terminal, 0, 0, 0, 1, 0});                                      // one format, endpoint 0x81
  append(stream, {27, 0x24, 4, 1, 1, 'Y', '1', '6', ' ', 0, 0, 0x10, 0, 0x80, 0, 0, 0xAA, 0, 0x38, 0x9B, 0x71, 16, 1, 0, 0, 0, 0});
  append(stream, {30, 0x24, 5, 1, 0, low(UsbVideoDevice::width), high(UsbVideoDevice::width), low(UsbVideoDevice::height), high(UsbVideoDevice::height)});
  append_u32(stream, image_bytes * 8 * 15);
  append_u32(stream, image_bytes * 8 * 15);
  append_u32(stream, image_bytes);
  append_u32(stream, frame_interval);
  append(stream, {1});
  append_u32(stream, frame_interval);
  append(stream, {6, 0x24, 13, 1, 1, 4});
  stream[4] = low(static_cast<unsigned>(stream.size()));
  stream[5] = high(static_cast<unsigned>(stream.size()));
  Bytes& c = d.configuration;
  append(c, {9, 2, 0, 0, 2, 1, 0, 0x80, 250});
  append(c, {8, 11, 0, 2, 14, 3, 0, 0});     // interface association
  append(c, {9, 4, 0, 0, 0, 14, 1, 0, 0});   // control interface
  c.insert(c.end(), control.begin(), control.end());
  append(c, {9, 4, 1, 0, 1, 14, 2, 0, 0});   // streaming interface
  c.insert(c.end(), stream.begin(), stream.end());
  append(c, {7, 5, 0x81, 2, 0x00, 0x02, 0});  // bulk IN, 512 bytes
  c[2] = low(static_cast<unsigned>(c.size()));
  c[3] = high(static_cast<unsigned>(c.size()));
  d.strings = {"Lacquer", "Lacquer UVC camera", "UVC1"};
  d.speed = 3;
  return d;
}

constexpr std::uint8_t set_cur = 0x01, get_cur = 0x81, get_min = 0x82, get_max = 0x83, get_res = 0x84, get_len = 0x85, get_info = 0x86, get_def = 0x87;

}  // namespace

UsbTicDevice::UsbTicDevice(std::shared_ptr<TicModel> model, const std::string& serial, std::uint16_t product, int port)
    : UsbipDevice(tic_descriptors(serial, product), port), model_(std::move(model)) {}

std::optional<Bytes> UsbTicDevice::control(const Setup& setup, const Bytes&) {
  return model_->control(setup.request_type, setup.request, setup.value, setup.index, setup.length);
}

UsbVideoDevice::UsbVideoDevice(Sensor sensor, int port) : UsbipDevice(video_descriptors(), port), sensor_(std::move(sensor)) {}

std::optional<Bytes> UsbVideoDevice::number_control(const Setup& setup, const Bytes& data, std::atomic<std::uint32_t>& value, std::size_t size, std::uint32_t min,
                                                    std::uint32_t max, std::uint32_t resolution) {
  std::uint32_t v = 0;
  switch (setup.request) {
    case set_cur:
      if (data.size() != size) return std::nullopt;
      for (std::size_t i = 0; i < size; ++i) v |= static_cast<std::uint32_t>(data[i]) << (8 * i);
      value = std::clamp(v, min, max);
      return Bytes{};
    case get_cur: v = value; break;
    case get_min: v = min; break;
    case get_max: v = max; break;
    case get_res: v = resolution; break;
    case get_def: v = max == 8 ? 8 : min; break;
    case get_len: return Bytes{low(static_cast<unsigned>(size)), 0};
    case get_info: return Bytes{3};  // can be read and set
    default: return std::nullopt;
  }
  Bytes answer;
  append_u32(answer, v);
  answer.resize(size);
  return answer;
}

/// Probe and commit: there is one format, one size and one rate to agree on.
std::optional<Bytes> UsbVideoDevice::stream_control(const Setup& setup, const Bytes&) {
  if (setup.request == set_cur) {
    if (setup.value >> 8 == 2) {  // commit: the stream starts anew
      sent_ = 0;
      image_.clear();
    }
    return Bytes{};
  }
  if (setup.request == get_len) return Bytes{34, 0};
  if (setup.request == get_info) return Bytes{3};
  Bytes probe{0, 0, 1, 1};
  append_u32(probe, frame_interval);
  probe.resize(18);
  append_u32(probe, image_bytes);
  append_u32(probe, payload_bytes);
  probe.resize(34);
  return probe;
}

std::optional<Bytes> UsbVideoDevice::control(const Setup& setup, const Bytes& data) {
  const unsigned selector = setup.value >> 8, entity = setup.index >> 8, interface = setup.index & 255;
  if (interface == 1) return stream_control(setup, data);
  if (entity == camera_terminal && selector == 2) return number_control(setup, data, mode_, 1, 1, 8, 1 | 8);  // resolution: the modes there are
  if (entity == camera_terminal && selector == 4) return number_control(setup, data, exposure_, 4, 1, 10000, 1);
  if (entity == processing_unit && selector == 4) return number_control(setup, data, gain_, 2, 0, 4, 1);
  return std::nullopt;
}

/// One payload per transfer: a header, then a part of the image; the last one of an image ends short.
std::optional<Bytes> UsbVideoDevice::bulk_in(std::size_t length) {
  const auto now = std::chrono::steady_clock::now();
  if (image_.empty()) {
    if (frozen_ || now < next_frame_) return std::nullopt;
    next_frame_ = now + std::chrono::microseconds(frame_interval / 10);
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        const unsigned v = sensor_(x, y, exposure_s());
        image_.push_back(low(v));
        image_.push_back(high(v));
      }
    sent_ = 0;
    odd_ = !odd_;
  }
  const std::size_t n = std::min({image_.size() - sent_, length - header_bytes, std::size_t{payload_bytes - header_bytes}});
  Bytes payload(header_bytes, 0);
  payload[0] = header_bytes;
  payload[1] = static_cast<std::uint8_t>(0x80 | (odd_ ? 1 : 0) | (sent_ + n == image_.size() ? 2 : 0));
  payload.insert(payload.end(), image_.begin() + static_cast<std::ptrdiff_t>(sent_), image_.begin() + static_cast<std::ptrdiff_t>(sent_ + n));
  sent_ += n;
  if (sent_ == image_.size()) image_.clear();
  return payload;
}

}  // namespace lacquer::test
