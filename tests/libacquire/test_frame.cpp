#include <cstring>
#include <random>

#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "libacquire/frame.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "test_support.h"

namespace lacquer::acquire {
namespace {

RawFrame random_frame(int width, int height, PixelLayout layout, int bits) {
  RawFrame frame{.width = width, .height = height, .layout = layout, .bits = bits, .data = {}, .actual = {}};
  std::mt19937 random(7);
  frame.data.resize(static_cast<std::size_t>(width * height * values_per_pixel(layout)));
  for (auto& v : frame.data) v = static_cast<std::uint16_t>(random() & ((1u << bits) - 1));
  frame.data.front() = static_cast<std::uint16_t>((1u << bits) - 1);
  frame.data.back() = 0;
  return frame;
}

std::string bytes_of(const std::filesystem::path& file) { return brdf::read_text(file); }

std::string error_of(const std::filesystem::path& file, int bits = 16) {
  try {
    read_frame(file.string(), bits, PixelLayout::mono);
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::file);
    EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos);
    return std::string(e.what()).substr(std::min(std::string(e.what()).size(), file.string().size() + 2));
  }
  return "no error";
}

/// A 5 x 4 image with values 0, 1, 2, ... written by OpenCV.
void write_image(const std::filesystem::path& file, int type) {
  cv::Mat image(4, 5, type, cv::Scalar(1, 2, 3, 4));
  ASSERT_TRUE(cv::imwrite(file.string(), image));
}

TEST(Frame, ComesBackFromTiffExactly) {
  const test::TemporaryFolder folder;
  for (const int bits : {8, 10, 12, 16})
    for (const PixelLayout layout : {PixelLayout::mono, PixelLayout::rgb, PixelLayout::bayer_gbrg}) {
      const RawFrame frame = random_frame(13, 7, layout, bits);
      const std::string file = (folder / "frame.tiff").string();
      const std::string checksum = write_frame(file, frame);
      const RawFrame back = read_frame(file, bits, PixelLayout::bayer_gbrg);
      EXPECT_EQ(back.data, frame.data) << bits << " bits, " << name_of(layout);
      EXPECT_EQ(back.width, 13);
      EXPECT_EQ(back.height, 7);
      EXPECT_EQ(back.bits, bits);
      EXPECT_EQ(back.layout, layout == PixelLayout::rgb ? PixelLayout::rgb : PixelLayout::bayer_gbrg);
      EXPECT_EQ(checksum, brdf::file_checksum(file));
    }
}

// A hand-made file fixes the order of channels and bytes independently of OpenCV: PPM is big-endian, R G B.
TEST(Frame, ChannelsAreRedGreenBlue) {
  const test::TemporaryFolder folder;
  test::write_file(folder / "a.ppm", std::string("P6\n1 1\n65535\n") + std::string("\x01\x02\x03\x04\x05\x06", 6));
  EXPECT_EQ(read_frame((folder / "a.ppm").string(), 16, PixelLayout::mono).data, (std::vector<std::uint16_t>{0x0102, 0x0304, 0x0506}));
}

// Uncompressed little-endian TIFF: the first strip of a 2 x 1 image holds the counts as they are.
TEST(Frame, TiffIsUncompressed) {
  const test::TemporaryFolder folder;
  RawFrame frame = random_frame(64, 64, PixelLayout::mono, 12);
  std::fill(frame.data.begin(), frame.data.end(), std::uint16_t{0x0abc});
  write_frame((folder / "a.tiff").string(), frame);
  std::string pixels;
  for (int i = 0; i < 64; ++i) pixels += "\xbc\x0a";
  const std::string bytes = bytes_of(folder / "a.tiff");
  EXPECT_GE(bytes.size(), 64u * 64u * 2u);
  EXPECT_NE(bytes.find(pixels), std::string::npos);
  frame.bits = 8;
  std::fill(frame.data.begin(), frame.data.end(), std::uint16_t{0xab});
  write_frame((folder / "b.tiff").string(), frame);
  EXPECT_LT(bytes_of(folder / "b.tiff").size(), 64u * 64u * 2u) << "8-bit counts take one byte";
}

TEST(Frame, TwelveBitPgmIsNotScaled) {
  const test::TemporaryFolder folder;
  test::write_file(folder / "a.pgm", std::string("P5\n# camera\n2 1\n4095\n") + std::string("\x0f\xff\x00\x07", 4));
  EXPECT_EQ(read_frame((folder / "a.pgm").string(), 12, PixelLayout::mono).data, (std::vector<std::uint16_t>{4095, 7}));
}

TEST(Frame, MosaicNamesSayTheTopLeftFourPixels) {
  const auto colors = [](const char* name) {
    const PixelLayout layout = pixel_layout_from_name(name);
    EXPECT_EQ(name_of(layout), name);
    std::string text;
    for (const auto& [x, y] : {std::pair{0, 0}, {1, 0}, {0, 1}, {1, 1}}) text += "rgb"[channel_of(layout, x + 4, y + 2, 0)];
    return text;
  };
  for (const char* name : {"rggb", "grbg", "gbrg", "bggr"}) EXPECT_EQ(colors(name), name);
  EXPECT_EQ(channel_of(PixelLayout::rgb, 5, 5, 2), 2);
  EXPECT_THROW(pixel_layout_from_name("rgbg"), Error);
}

TEST(Frame, ValueAboveTheBitsNamesThePixel) {
  const test::TemporaryFolder folder;
  RawFrame frame = random_frame(6, 5, PixelLayout::mono, 12);
  frame.bits = 16;
  frame.data[6 * 3 + 2] = 5000;
  write_frame((folder / "a.tiff").string(), frame);
  EXPECT_EQ(error_of(folder / "a.tiff", 12), "pixel (2, 3) has value 5000; expected 12 bits, at most 4095; are the bits right?");
}

TEST(Frame, OtherKindsOfImagesAreRefused) {
  const test::TemporaryFolder folder;
  EXPECT_EQ(error_of(folder / "none.png"), "cannot be opened: No such file or directory");
  test::write_file(folder / "empty.png", "");
  EXPECT_EQ(error_of(folder / "empty.png"), "file is empty; expected an image");
  test::write_file(folder / "text.png", "this is not an image at all");
  EXPECT_EQ(error_of(folder / "text.png"), "not an image that holds raw counts; expected PNG, TIFF, binary PGM/PPM or JPEG");
  write_image(folder / "alpha.png", CV_8UC4);
  EXPECT_EQ(error_of(folder / "alpha.png", 8), "image has an alpha channel; expected grey or RGB without alpha");
  write_image(folder / "alpha.tiff", CV_16UC4);
  EXPECT_EQ(error_of(folder / "alpha.tiff"), "image has an alpha channel; expected grey or RGB without alpha");
  write_image(folder / "float.tiff", CV_32FC1);
  EXPECT_EQ(error_of(folder / "float.tiff"), "image has 32 bits per value; expected 8 or 16");
  write_image(folder / "eight.png", CV_8UC1);
  EXPECT_EQ(error_of(folder / "eight.png", 12), "image has 8 bits per value; expected a 16-bit file for 12-bit counts");
  EXPECT_EQ(error_of(folder / "eight.png", 8), "no error");
}

TEST(Frame, ForgedSizeIsRefusedBeforeMemoryIsTaken) {
  const test::TemporaryFolder folder;
  test::write_file(folder / "a.pgm", "P5\n100000 100000\n65535\n1234");
  EXPECT_EQ(error_of(folder / "a.pgm"), "image of 100000 x 100000 pixels; expected at least 1 x 1 and at most 134217728 pixels");
  test::write_file(folder / "b.pgm", "P5\n99999999999999999999 1\n65535\n1234");
  EXPECT_NE(error_of(folder / "b.pgm"), "no error");
}

// OpenCV and the libraries behind it return half an image, or fill in grey, for some of these; none may come through.
TEST(Frame, TruncatedFileIsAnErrorWhereverItIsCut) {
  const test::TemporaryFolder folder;
  const RawFrame frame = random_frame(40, 30, PixelLayout::rgb, 8);
  cv::Mat image(30, 40, CV_8UC3);
  std::copy(frame.data.begin(), frame.data.end(), image.data);
  for (const char* name : {"a.png", "a.tiff", "a.jpg", "a.ppm"}) {
    ASSERT_TRUE(cv::imwrite((folder / name).string(), image));
    const std::string whole = bytes_of(folder / name);
    ASSERT_NO_THROW(read_frame((folder / name).string(), 8, PixelLayout::mono)) << name;
    const std::size_t step = std::max<std::size_t>(1, whole.size() / 97);
    for (std::size_t size = 0; size < whole.size(); size += step) {
      test::write_file(folder / name, whole.substr(0, size));
      EXPECT_NE(error_of(folder / name, 8), "no error") << name << " cut to " << size << " of " << whole.size() << " bytes";
    }
    test::write_file(folder / name, whole.substr(0, whole.size() - 2));
    EXPECT_NE(error_of(folder / name, 8), "no error") << name << " without its last two bytes";
  }
}

TEST(Frame, DamagedPngDataIsAnError) {
  const test::TemporaryFolder folder;
  cv::Mat image(64, 64, CV_16UC1);
  for (int i = 0; i < 64 * 64; ++i) image.at<std::uint16_t>(i / 64, i % 64) = static_cast<std::uint16_t>(i * 17);
  ASSERT_TRUE(cv::imwrite((folder / "a.png").string(), image));
  const std::string whole = bytes_of(folder / "a.png");
  for (std::size_t at = 16; at < whole.size(); at += whole.size() / 50) {
    std::string damaged = whole;
    damaged[at] = static_cast<char>(damaged[at] ^ 0x10);
    test::write_file(folder / "a.png", damaged);
    EXPECT_NE(error_of(folder / "a.png"), "no error") << "byte " << at;
  }
}

// Any byte of a TIFF changed: an error or an image of the stated size, never a crash (run under the sanitizers too).
TEST(Frame, DamagedTiffNeverCrashes) {
  const test::TemporaryFolder folder;
  write_frame((folder / "a.tiff").string(), random_frame(9, 8, PixelLayout::mono, 12));
  const std::string whole = bytes_of(folder / "a.tiff");
  std::vector<std::byte> bytes(whole.size());
  for (std::size_t at = 0; at < whole.size(); ++at)
    for (const int flip : {0x01, 0x80, 0xff}) {
      std::memcpy(bytes.data(), whole.data(), whole.size());
      bytes[at] ^= static_cast<std::byte>(flip);
      try {
        const RawFrame frame = decode_frame(bytes, "a.tiff", 16, PixelLayout::mono);
        EXPECT_EQ(frame.data.size(), static_cast<std::size_t>(frame.width) * frame.height * values_per_pixel(frame.layout));
      } catch (const Error&) {
      }
    }
}

TEST(Frame, WritingIntoAMissingFolderIsAnErrorAndLeavesNothing) {
  const test::TemporaryFolder folder;
  EXPECT_THROW(write_frame((folder / "none/a.tiff").string(), random_frame(2, 2, PixelLayout::mono, 8)), Error);
  RawFrame wrong = random_frame(4, 4, PixelLayout::mono, 12);
  wrong.data.pop_back();
  EXPECT_THROW(write_frame((folder / "a.tiff").string(), wrong), Error);
  EXPECT_TRUE(std::filesystem::is_empty(folder.path()));
}

}  // namespace
}  // namespace lacquer::acquire
