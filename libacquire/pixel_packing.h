#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace lacquer::acquire {

/// How the values of a raw image lie in memory. Names: GenICam's Pixel Format Naming Convention (PFNC), GigE Vision 1, V4L2.
enum class Packing {
  bytes,       ///< 8 bit: Mono8, GREY
  words_le,    ///< 9..16 bit right-aligned in 16, little-endian: Mono10, Mono12, Mono16, Y10, Y12, Y16
  words_be,    ///< the same, big-endian: Y16_BE
  stream_10,   ///< PFNC "p": a bit stream, lowest bit first; 4 values in 5 bytes: Mono10p
  stream_12,   ///< 2 values in 3 bytes: Mono12p
  gige_10,     ///< GigE Vision "Packed": high 8 bits of the first, low bits of both (at bits 0 and 4), high 8 bits of the second: Mono10Packed
  gige_12,     ///< the same with 4 low bits: Mono12Packed
  mipi_10,     ///< MIPI CSI-2 RAW10: high 8 bits of four values, then their low bits in a fifth byte: Y10P
  mipi_12,     ///< RAW12: high 8 bits of two values, then their low bits: Y12P
};

/// Bytes that `n` values take; a last group that is not full counts with the bytes it needs.
std::size_t packed_bytes(Packing packing, std::size_t n);

/// Right-aligned values, as many as `values` holds. Precondition: bytes.size() >= packed_bytes(packing, values.size()).
void unpack(Packing packing, std::span<const std::uint8_t> bytes, std::span<std::uint16_t> values);

}  // namespace lacquer::acquire
