#include "libacquire/pixel_packing.h"

#include <cassert>

namespace lacquer::acquire {

namespace {

constexpr std::uint16_t word(unsigned v) { return static_cast<std::uint16_t>(v); }

/// `bits` per value, the lowest bit first, from the lowest bit of each byte on.
void unpack_stream(unsigned bits, std::span<const std::uint8_t> b, std::span<std::uint16_t> v) {
  unsigned buffer = 0, filled = 0;
  std::size_t next = 0;
  for (std::uint16_t& value : v) {
    while (filled < bits) {
      buffer |= static_cast<unsigned>(b[next++]) << filled;
      filled += 8;
    }
    value = word(buffer & ((1u << bits) - 1));
    buffer >>= bits;
    filled -= bits;
  }
}

/// Byte 0: high bits of the first, byte 1: low bits of the first (from bit 0) and second (from bit 4), byte 2: high bits of the second.
void unpack_gige(unsigned low_bits, std::span<const std::uint8_t> b, std::span<std::uint16_t> v) {
  const unsigned mask = (1u << low_bits) - 1;
  for (std::size_t i = 0; i < v.size(); ++i) {
    const std::size_t group = i / 2 * 3;
    v[i] = i % 2 == 0 ? word(static_cast<unsigned>(b[group]) << low_bits | (b[group + 1] & mask))
                      : word(static_cast<unsigned>(b[group + 2]) << low_bits | (static_cast<unsigned>(b[group + 1]) >> 4 & mask));
  }
}

/// `per_group` bytes of high bits, then one byte of low bits, those of the first value lowest.
void unpack_mipi(unsigned low_bits, std::size_t per_group, std::span<const std::uint8_t> b, std::span<std::uint16_t> v) {
  const unsigned mask = (1u << low_bits) - 1;
  for (std::size_t i = 0; i < v.size(); ++i) {
    const std::size_t group = i / per_group * (per_group + 1), k = i % per_group;
    v[i] = word(static_cast<unsigned>(b[group + k]) << low_bits | (static_cast<unsigned>(b[group + per_group]) >> (k * low_bits) & mask));
  }
}

}  // namespace

std::size_t packed_bytes(Packing packing, std::size_t n) {
  switch (packing) {
    case Packing::bytes: return n;
    case Packing::words_le:
    case Packing::words_be: return 2 * n;
    case Packing::stream_10: return n / 4 * 5 + (n % 4 * 10 + 7) / 8;
    case Packing::stream_12: return n / 2 * 3 + n % 2 * 2;
    case Packing::gige_10:
    case Packing::gige_12: return n / 2 * 3 + n % 2 * 2;
    case Packing::mipi_10: return (n + 3) / 4 * 5;  // the low bits come last, so the group must be there to its end
    case Packing::mipi_12: return (n + 1) / 2 * 3;
  }
  return 0;
}

void unpack(Packing packing, std::span<const std::uint8_t> bytes, std::span<std::uint16_t> values) {
  assert(bytes.size() >= packed_bytes(packing, values.size()));
  switch (packing) {
    case Packing::bytes:
      for (std::size_t i = 0; i < values.size(); ++i) values[i] = bytes[i];
      return;
    case Packing::words_le:
      for (std::size_t i = 0; i < values.size(); ++i) values[i] = word(bytes[2 * i] | static_cast<unsigned>(bytes[2 * i + 1]) << 8);
      return;
    case Packing::words_be:
      for (std::size_t i = 0; i < values.size(); ++i) values[i] = word(bytes[2 * i + 1] | static_cast<unsigned>(bytes[2 * i]) << 8);
      return;
    case Packing::stream_10: return unpack_stream(10, bytes, values);
    case Packing::stream_12: return unpack_stream(12, bytes, values);
    case Packing::gige_10: return unpack_gige(2, bytes, values);
    case Packing::gige_12: return unpack_gige(4, bytes, values);
    case Packing::mipi_10: return unpack_mipi(2, 4, bytes, values);
    case Packing::mipi_12: return unpack_mipi(4, 2, bytes, values);
  }
}

}  // namespace lacquer::acquire
