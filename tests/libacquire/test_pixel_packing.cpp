#include "libacquire/pixel_packing.h"

#include <gtest/gtest.h>

#include <vector>

namespace lacquer::acquire {
namespace {

std::vector<std::uint16_t> unpacked(Packing packing, const std::vector<std::uint8_t>& bytes, std::size_t n) {
  std::vector<std::uint16_t> values(n);
  EXPECT_EQ(packed_bytes(packing, n), bytes.size());
  unpack(packing, bytes, values);
  return values;
}

using Values = std::vector<std::uint16_t>;

// Worked out by hand from the tables of the GenICam PFNC 2.4, GigE Vision 1.2 (24.2.5, 24.2.7), and the V4L2 documentation (Y10P, Y12P).
// The values have no two equal nibbles in equal places, so that no two bits can be swapped unseen:
//   0x123 = 01 0010 0011   0x2CE = 10 1100 1110   0x391 = 11 1001 0001   0x07A = 00 0111 1010
TEST(PixelPacking, TenBitsInAStreamLowestFirst) {
  // 40-bit little-endian number: 0x07A << 30 | 0x391 << 20 | 0x2CE << 10 | 0x123 = 0x1E B9 1B 39 23
  EXPECT_EQ(unpacked(Packing::stream_10, {0x23, 0x39, 0x1B, 0xB9, 0x1E}, 4), (Values{0x123, 0x2CE, 0x391, 0x07A}));
}

TEST(PixelPacking, TwelveBitsInAStreamLowestFirst) {
  EXPECT_EQ(unpacked(Packing::stream_12, {0xBC, 0x3A, 0x12}, 2), (Values{0xABC, 0x123}));
}

TEST(PixelPacking, GigETwelveBits) {
  EXPECT_EQ(unpacked(Packing::gige_12, {0xAB, 0x3C, 0x12}, 2), (Values{0xABC, 0x123}));
}

TEST(PixelPacking, GigETenBits) {
  // 0x123: high 0x48, low 3; 0x2CE: high 0xB3, low 2 at bits 4..5; the other bits of the byte say nothing.
  EXPECT_EQ(unpacked(Packing::gige_10, {0x48, 0x23, 0xB3}, 2), (Values{0x123, 0x2CE}));
  EXPECT_EQ(unpacked(Packing::gige_10, {0x48, 0xEF, 0xB3}, 2), (Values{0x123, 0x2CE}));
}

TEST(PixelPacking, MipiTenBits) {
  // High bits 0x48 0xB3 0xE4 0x1E; low bits 3, 2, 1, 2 from bit 0 on: 10 01 10 11 = 0x9B.
  EXPECT_EQ(unpacked(Packing::mipi_10, {0x48, 0xB3, 0xE4, 0x1E, 0x9B}, 4), (Values{0x123, 0x2CE, 0x391, 0x07A}));
}

TEST(PixelPacking, MipiTwelveBits) {
  EXPECT_EQ(unpacked(Packing::mipi_12, {0xAB, 0x12, 0x3C}, 2), (Values{0xABC, 0x123}));
}

TEST(PixelPacking, BytesAndWords) {
  EXPECT_EQ(unpacked(Packing::bytes, {0, 1, 255}, 3), (Values{0, 1, 255}));
  EXPECT_EQ(unpacked(Packing::words_le, {0x34, 0x12, 0xFF, 0xFF}, 2), (Values{0x1234, 0xFFFF}));
  EXPECT_EQ(unpacked(Packing::words_be, {0x12, 0x34, 0x00, 0xFF}, 2), (Values{0x1234, 0x00FF}));
}

TEST(PixelPacking, LastGroupMayBePartlyFull) {
  EXPECT_EQ(unpacked(Packing::stream_10, {0x23, 0x39, 0x0B}, 2), (Values{0x123, 0x2CE}));  // 20 bits; 4 bits of the third byte are unused
  EXPECT_EQ(unpacked(Packing::stream_12, {0xBC, 0x0A}, 1), (Values{0xABC}));
  EXPECT_EQ(unpacked(Packing::gige_12, {0xAB, 0x0C}, 1), (Values{0xABC}));
  EXPECT_EQ(unpacked(Packing::mipi_10, {0x48, 0, 0, 0, 0x03}, 1), (Values{0x123}));
  EXPECT_EQ(unpacked(Packing::mipi_12, {0xAB, 0, 0x0C}, 1), (Values{0xABC}));
}

TEST(PixelPacking, GroupsFollowEachOther) {
  EXPECT_EQ(unpacked(Packing::gige_12, {0xAB, 0x3C, 0x12, 0xFF, 0x0F, 0x00}, 4), (Values{0xABC, 0x123, 0xFFF, 0x000}));
  EXPECT_EQ(unpacked(Packing::stream_12, {0xBC, 0x3A, 0x12, 0xFF, 0x0F, 0x00}, 4), (Values{0xABC, 0x123, 0xFFF, 0x000}));
}

/// Each bit of memory belongs to one bit of one value: lighting one bit lights one bit, and all are met.
TEST(PixelPacking, EveryBitOfMemoryIsOneBitOfOneValue) {
  for (const auto& [packing, bits, n] : std::vector<std::tuple<Packing, int, std::size_t>>{
           {Packing::bytes, 8, 4}, {Packing::words_le, 16, 4}, {Packing::words_be, 16, 4}, {Packing::stream_10, 10, 8}, {Packing::stream_12, 12, 8},
           {Packing::gige_12, 12, 8}, {Packing::mipi_10, 10, 8}, {Packing::mipi_12, 12, 8}}) {
    std::vector<int> met(n * 16, 0);
    std::vector<std::uint8_t> memory(packed_bytes(packing, n), 0);
    ASSERT_EQ(memory.size() * 8, n * static_cast<std::size_t>(bits));
    for (std::size_t bit = 0; bit < memory.size() * 8; ++bit) {
      memory[bit / 8] = static_cast<std::uint8_t>(1u << bit % 8);
      std::vector<std::uint16_t> values(n);
      unpack(packing, memory, values);
      memory[bit / 8] = 0;
      int lit = 0;
      for (std::size_t i = 0; i < n; ++i)
        for (int k = 0; k < 16; ++k)
          if (values[i] >> k & 1) {
            ++lit;
            ++met[i * 16 + static_cast<std::size_t>(k)];
          }
      EXPECT_EQ(lit, 1);
    }
    for (std::size_t i = 0; i < n; ++i)
      for (int k = 0; k < 16; ++k) EXPECT_EQ(met[i * 16 + static_cast<std::size_t>(k)], k < bits ? 1 : 0);
  }
}

}  // namespace
}  // namespace lacquer::acquire
