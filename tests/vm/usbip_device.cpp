#include "vm/usbip_device.h"

#include <arpa/inet.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <stdexcept>

namespace lacquer::test {

namespace {

constexpr std::uint32_t cmd_submit = 1, cmd_unlink = 2, ret_submit = 3, ret_unlink = 4;
constexpr const char* attach_file = "/sys/devices/platform/vhci_hcd.0/attach";
using Header = std::array<std::uint32_t, 12>;  // 48 bytes, big-endian; the last two words of a submit are the setup packet

bool read_all(int fd, void* memory, std::size_t n) {
  auto* p = static_cast<char*>(memory);
  while (n > 0) {
    const ssize_t got = recv(fd, p, n, 0);
    if (got <= 0) return false;
    p += got;
    n -= static_cast<std::size_t>(got);
  }
  return true;
}

void write_all(int fd, const void* memory, std::size_t n) {
  const auto* p = static_cast<const char*>(memory);
  while (n > 0) {
    const ssize_t put = send(fd, p, n, MSG_NOSIGNAL);
    if (put <= 0) return;  // unplugged
    p += put;
    n -= static_cast<std::size_t>(put);
  }
}

}  // namespace

void UsbipDevice::plug_in() {
  int pair[2];
  if (socketpair(AF_UNIX, SOCK_STREAM, 0, pair) != 0) throw std::runtime_error("no socket pair");
  socket_ = pair[0];
  {
    std::ofstream attach(attach_file);
    attach << port_ << ' ' << pair[1] << ' ' << (0x10002 + port_) << ' ' << descriptors_.speed << std::endl;
    if (!attach) throw std::runtime_error(std::string(attach_file) + " refuses the device: " + std::strerror(errno));
  }
  close(pair[1]);  // the kernel has its own reference
  stop_ = false;
  pending_.clear();
  thread_ = std::thread([this] { serve(); });
}

void UsbipDevice::unplug() {
  if (socket_ < 0) return;
  stop_ = true;
  shutdown(socket_, SHUT_RDWR);
  thread_.join();
  close(socket_);
  socket_ = -1;
  usleep(300000);  // the kernel takes the device off its port
}

void UsbipDevice::serve() {
  while (!stop_) {
    pollfd p{socket_, POLLIN, 0};
    if (poll(&p, 1, pending_.empty() ? 100 : 2) > 0 && !serve_one()) return;
    answer_bulk();
  }
}

void UsbipDevice::answer_bulk() {
  while (!pending_.empty()) {
    const auto data = bulk_in(pending_.front().length);
    if (!data) return;
    reply(pending_.front().sequence, true, 0, *data, 0);
    pending_.pop_front();
  }
}

bool UsbipDevice::serve_one() {
  Header h;
  if (!read_all(socket_, h.data(), sizeof(h))) return false;
  std::array<std::uint8_t, 8> setup_bytes;
  std::memcpy(setup_bytes.data(), &h[10], 8);
  for (auto& w : h) w = ntohl(w);
  const std::uint32_t command = h[0], sequence = h[1], length = h[6];
  const bool in = h[3] == 1;
  if (command == cmd_unlink) {
    const auto found = std::find_if(pending_.begin(), pending_.end(), [&](const Pending& p) { return p.sequence == h[5]; });
    Header r{};
    r[0] = htonl(ret_unlink);
    r[1] = htonl(sequence);
    r[5] = htonl(found == pending_.end() ? 0u : static_cast<std::uint32_t>(-ECONNRESET));
    if (found != pending_.end()) pending_.erase(found);
    write_all(socket_, r.data(), sizeof(r));
    return true;
  }
  if (command != cmd_submit || length > (1u << 24)) return false;
  std::vector<std::uint8_t> out(in ? 0 : length);
  if (!out.empty() && !read_all(socket_, out.data(), out.size())) return false;
  if (h[4] != 0) {
    if (in)
      pending_.push_back({sequence, length});
    else
      reply(sequence, false, 0, {}, length);
    return true;
  }
  const auto word = [&](std::size_t i) { return static_cast<std::uint16_t>(setup_bytes[i] | setup_bytes[i + 1] << 8); };
  const Setup setup{setup_bytes[0], setup_bytes[1], word(2), word(4), word(6)};
  auto data = (setup.request_type & 0x60) == 0 ? standard(setup) : control(setup, out);
  if (data && data->size() > length) data->resize(length);
  reply(sequence, in, data ? 0 : -EPIPE, data.value_or(std::vector<std::uint8_t>{}), length);
  return true;
}

void UsbipDevice::reply(std::uint32_t sequence, bool in, std::int32_t status, const std::vector<std::uint8_t>& data, std::uint32_t n_out) {
  Header r{};
  r[0] = htonl(ret_submit);
  r[1] = htonl(sequence);
  r[5] = htonl(static_cast<std::uint32_t>(status));
  r[6] = htonl(in ? static_cast<std::uint32_t>(data.size()) : status == 0 ? n_out : 0);
  r[8] = htonl(0xFFFFFFFFu);  // number of packets: not isochronous
  write_all(socket_, r.data(), sizeof(r));
  if (in && !data.empty()) write_all(socket_, data.data(), data.size());
}

std::optional<std::vector<std::uint8_t>> UsbipDevice::standard(const Setup& setup) const {
  switch (setup.request) {
    case 0x00: return std::vector<std::uint8_t>{0, 0};  // GET_STATUS
    case 0x01:                                          // CLEAR_FEATURE
    case 0x09:                                          // SET_CONFIGURATION
    case 0x0B: return std::vector<std::uint8_t>{};      // SET_INTERFACE
    case 0x08: return std::vector<std::uint8_t>{1};     // GET_CONFIGURATION
    case 0x06: break;
    default: return std::nullopt;
  }
  const unsigned type = setup.value >> 8, index = setup.value & 255;
  if (type == 1) return descriptors_.device;
  if (type == 2) return descriptors_.configuration;
  if (type != 3 || index > descriptors_.strings.size()) return std::nullopt;
  if (index == 0) return std::vector<std::uint8_t>{4, 3, 9, 4};
  const std::string& text = descriptors_.strings[index - 1];
  std::vector<std::uint8_t> d{static_cast<std::uint8_t>(2 + 2 * text.size()), 3};
  for (const char c : text) d.insert(d.end(), {static_cast<std::uint8_t>(c), 0});
  return d;
}

}  // namespace lacquer::test
