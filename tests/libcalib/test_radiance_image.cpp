#include "libcalib/radiance_image.h"

#include <cmath>
#include <cstring>
#include <limits>

#include "libbrdf/error.h"
#include "test_support.h"

namespace lacquer::calib {
namespace {

using acquire::PixelLayout;

RadianceImage sample(PixelLayout layout, int width, int height) {
  RadianceImage image{width, height, layout, {}, {}, {}};
  const auto n = static_cast<std::size_t>(width * height * acquire::values_per_pixel(layout));
  for (std::size_t i = 0; i < n; ++i) {
    image.radiance.push_back(std::ldexp(1.0f + static_cast<float>(i) * 0.001f, static_cast<int>(i % 60) - 30) * (i % 5 ? 1.0f : -1.0f));
    image.variance.push_back(static_cast<float>(i) * 1e-7f);
    image.flags.push_back(static_cast<PixelFlag>(i % 4));
  }
  return image;
}

std::string read_error(const std::filesystem::path& file) {
  try {
    read_radiance(file);
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::file);
    EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos) << "one line";
    EXPECT_EQ(std::string(e.what()).rfind(file.string() + ": ", 0), 0u) << e.what();
    return e.what();
  }
  return "no error";
}

std::string slurp(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

TEST(RadianceImage, EveryLayoutComesBackBitByBit) {
  const test::TemporaryFolder folder;
  for (const auto layout : {PixelLayout::mono, PixelLayout::rgb, PixelLayout::bayer_rggb, PixelLayout::bayer_bggr}) {
    const RadianceImage image = sample(layout, 13, 7);
    write_radiance(folder / "a.exr", image);
    const RadianceImage back = read_radiance(folder / "a.exr");
    EXPECT_EQ(back.width, 13);
    EXPECT_EQ(back.height, 7);
    EXPECT_EQ(back.layout, layout);
    EXPECT_EQ(back.radiance, image.radiance);
    EXPECT_EQ(back.variance, image.variance);
    EXPECT_EQ(back.flags, image.flags);
  }
}

// Values out of the file's bytes, found by hand: an uncompressed scan line stores, per channel in alphabetical order, its row of
// values (OpenEXR file layout). One mono pixel: Y (float), Y.flag (uint), Y.variance (float) are the last twelve bytes.
TEST(RadianceImage, ChannelsLieInTheFileAsOpenExrDefinesThem) {
  const test::TemporaryFolder folder;
  write_radiance(folder / "a.exr", {1, 1, PixelLayout::mono, {2.5f}, {0.125f}, {PixelFlag::dark}});
  const std::string bytes = slurp(folder / "a.exr");
  float y, variance;
  std::uint32_t flag;
  std::memcpy(&y, &bytes[bytes.size() - 12], 4);
  std::memcpy(&flag, &bytes[bytes.size() - 8], 4);
  std::memcpy(&variance, &bytes[bytes.size() - 4], 4);
  EXPECT_EQ(y, 2.5f);
  EXPECT_EQ(flag, 2u);
  EXPECT_EQ(variance, 0.125f);
}

TEST(RadianceImage, AnImageOfTheWrongShapeIsRefusedBeforeAnythingIsWritten) {
  const test::TemporaryFolder folder;
  RadianceImage image = sample(PixelLayout::rgb, 4, 4);
  image.flags.pop_back();
  EXPECT_THROW(write_radiance(folder / "a.exr", image), Error);
  EXPECT_FALSE(std::filesystem::exists(folder / "a.exr"));
}

TEST(RadianceImage, MissingTextAndEmptyFilesGiveOneClearLine) {
  const test::TemporaryFolder folder;
  EXPECT_NE(read_error(folder / "none.exr").find("no such file"), std::string::npos);
  EXPECT_NE(read_error(folder.path()).find("no such file"), std::string::npos);
  test::write_file(folder / "text.exr", "not an image");
  EXPECT_NE(read_error(folder / "text.exr"), "no error");
  test::write_file(folder / "empty.exr", "");
  EXPECT_NE(read_error(folder / "empty.exr"), "no error");
}

TEST(RadianceImage, EveryTruncationIsRefused) {
  const test::TemporaryFolder folder;
  write_radiance(folder / "a.exr", sample(PixelLayout::mono, 5, 3));
  const std::string whole = slurp(folder / "a.exr");
  for (std::size_t n = 0; n < whole.size(); n += 7) {
    test::write_file(folder / "cut.exr", whole.substr(0, n));
    EXPECT_NE(read_error(folder / "cut.exr"), "no error") << n << " of " << whole.size() << " bytes";
  }
}

/// The file of `image` with the bytes of one attribute replaced; `pattern` occurs once.
void patch(const std::filesystem::path& file, const std::string& pattern, std::size_t offset, const std::string& bytes) {
  std::string content = slurp(file);
  const std::size_t at = content.find(pattern);
  ASSERT_NE(at, std::string::npos);
  content.replace(at + pattern.size() + offset, bytes.size(), bytes);
  test::write_file(file, content);
}

std::string int_bytes(std::initializer_list<std::int32_t> values) {
  std::string bytes;
  for (const std::int32_t v : values) bytes.append(reinterpret_cast<const char*>(&v), 4);
  return bytes;
}

TEST(RadianceImage, AnImageLargerThanItsFileIsRefused) {
  const test::TemporaryFolder folder;
  for (const auto& [x, y] : {std::pair{5, 2}, {4, 3}, {30000, 2}, {2, 30000}, {8000, 8000}, {0x7ffffff0, 2}, {0x7ffffff0, 0x7ffffff0}}) {
    write_radiance(folder / "a.exr", sample(PixelLayout::mono, 5, 3));
    patch(folder / "a.exr", std::string("dataWindow\0box2i\0", 17), 4, int_bytes({0, 0, x, y}));
    EXPECT_NE(read_error(folder / "a.exr"), "no error") << x << " x " << y;
  }
}

TEST(RadianceImage, WrongVersionLayoutAndMissingAttributesAreNamed) {
  const test::TemporaryFolder folder;
  const auto file = folder / "a.exr";
  write_radiance(file, sample(PixelLayout::bayer_rggb, 5, 3));
  patch(file, std::string("lacquer.version\0int\0", 20), 4, int_bytes({7}));
  EXPECT_NE(read_error(file).find("lacquer.version: expected 1, got 7"), std::string::npos);
  write_radiance(file, sample(PixelLayout::bayer_rggb, 5, 3));
  patch(file, std::string("lacquer.layout\0string\0", 22), 4, "xxxx");
  EXPECT_NE(read_error(file).find("lacquer.layout: "), std::string::npos);
  write_radiance(file, sample(PixelLayout::mono, 5, 3));
  patch(file, "lacquer.versi", 0, "xx");
  EXPECT_NE(read_error(file).find("not a radiance image of lacquer merge"), std::string::npos);
  write_radiance(file, sample(PixelLayout::mono, 5, 3));
  patch(file, "Y.vari", 0, "x");
  EXPECT_NE(read_error(file).find("channel Y.variance"), std::string::npos);
}

TEST(RadianceImage, NonsenseValuesAreNamedWithTheirPixel) {
  const test::TemporaryFolder folder;
  const auto file = folder / "a.exr";
  RadianceImage image = sample(PixelLayout::rgb, 5, 3);
  image.radiance[3 * 7 + 1] = std::numeric_limits<float>::quiet_NaN();  // pixel 7: (2, 1)
  write_radiance(file, image);
  EXPECT_NE(read_error(file).find("pixel (2, 1): radiance"), std::string::npos);
  image = sample(PixelLayout::mono, 5, 3);
  image.variance[4] = -1;
  write_radiance(file, image);
  EXPECT_NE(read_error(file).find("pixel (4, 0): variance"), std::string::npos);
  image = sample(PixelLayout::mono, 5, 3);
  image.flags[0] = static_cast<PixelFlag>(9);
  write_radiance(file, image);
  EXPECT_NE(read_error(file).find("pixel (0, 0): flag"), std::string::npos);
}

TEST(RadianceImage, AFolderThatDoesNotExistIsAnError) {
  const test::TemporaryFolder folder;
  EXPECT_THROW(write_radiance(folder / "no/such/a.exr", sample(PixelLayout::mono, 2, 2)), Error);
}

}  // namespace
}  // namespace lacquer::calib
