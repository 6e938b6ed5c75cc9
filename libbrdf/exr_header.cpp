#include "libbrdf/exr_header.h"

#include <fmt/format.h>

#include <array>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include "libbrdf/file_error.h"
#include "libbrdf/files.h"

namespace lacquer::brdf {

namespace {

constexpr std::size_t max_header_bytes = 16u << 20;  // provenance text is the only attribute that grows
constexpr std::array<unsigned char, 4> exr_magic{0x76, 0x2f, 0x31, 0x01};
constexpr std::uint32_t exr_version = 2;
constexpr std::uint32_t long_names_flag = 0x400;  // the only flag a single-part scan-line file may have

/// Reads the header front to back; "OpenEXR File Layout", section "Header".
class HeaderCursor {
 public:
  HeaderCursor(const std::filesystem::path& file, std::span<const std::byte> bytes) : file_(file), bytes_(bytes) {}

  template <typename T>
  T number() {
    T value;
    std::memcpy(&value, take(sizeof(T)).data(), sizeof(T));
    return value;
  }

  std::string text() {
    std::string s;
    while (const char c = number<char>()) s += c;
    return s;
  }

  std::span<const std::byte> take(std::size_t size) {
    if (size > bytes_.size()) fail_file(file_, "OpenEXR header is damaged or truncated");
    const auto part = bytes_.first(size);
    bytes_ = bytes_.subspan(size);
    return part;
  }

 private:
  const std::filesystem::path& file_;
  std::span<const std::byte> bytes_;
};

void check_data_window(const std::filesystem::path& file, std::span<const std::byte> value, const ExrExpectation& expected) {
  std::array<std::int32_t, 4> box;
  if (value.size() != sizeof(box)) fail_file(file, "dataWindow: expected 4 integers");
  std::memcpy(box.data(), value.data(), sizeof(box));
  if (box != std::array<std::int32_t, 4>{0, 0, expected.width - 1, expected.height - 1})
    fail_file(file, fmt::format("dataWindow: expected (0, 0) to ({}, {}) of {}, got ({}, {}) to ({}, {})", expected.width - 1,
                                expected.height - 1, expected.what, box[0], box[1], box[2], box[3]));
}

/// The channel list: name, then 16 bytes each, closed by an empty name.
void check_channel_count(const std::filesystem::path& file, std::span<const std::byte> value, const ExrExpectation& expected) {
  HeaderCursor cursor(file, value);
  for (int n = 0; !cursor.text().empty(); ++n) {
    if (n == expected.max_channels)
      fail_file(file, fmt::format("channels: expected at most {} of {}, got more", expected.max_channels, expected.what));
    cursor.take(16);
  }
}

}  // namespace

void check_exr_header(const std::filesystem::path& file, const ExrExpectation& expected) {
  const std::vector<std::byte> bytes = read_prefix(file, max_header_bytes);
  HeaderCursor cursor(file, bytes);
  if (bytes.size() < exr_magic.size() || std::memcmp(cursor.take(exr_magic.size()).data(), exr_magic.data(), exr_magic.size()) != 0)
    fail_file(file, "is not an OpenEXR file");
  const auto version = cursor.number<std::uint32_t>();
  if ((version & ~long_names_flag) != exr_version)
    fail_file(file, fmt::format("expected a single-part scan-line OpenEXR file of version 2 ({}), got version field {:#x}", expected.what, version));

  bool has_window = false;
  for (std::string name = cursor.text(); !name.empty(); name = cursor.text()) {
    const std::string type = cursor.text();
    const auto size = cursor.number<std::int32_t>();
    if (size < 0) fail_file(file, fmt::format("attribute {} has a negative size", printable(name)));
    const auto value = cursor.take(static_cast<std::size_t>(size));
    if (name == "channels") check_channel_count(file, value, expected);
    if (name != "dataWindow") continue;
    check_data_window(file, value, expected);
    has_window = true;
  }
  if (!has_window) fail_file(file, "dataWindow is missing");
}

}  // namespace lacquer::brdf
