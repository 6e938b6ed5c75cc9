#include "libcalib/sensor_maps.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>

#include "libbrdf/error.h"
#include "libcalib/radiance_image.h"
#include "test_support.h"

namespace lacquer::calib {
namespace {

using acquire::PixelLayout;

SensorMaps sample(PixelLayout layout, int width, int height) {
  SensorMaps maps{width, height, layout, {}, {}, {}, 0.00125, {}, 0.25, 1e-3};
  for (std::size_t i = 0; i < maps.n_values(); ++i) {
    maps.offset.push_back(static_cast<float>(std::sin(static_cast<double>(i)) * 3));
    maps.dark_rate.push_back(std::ldexp(1.0f, static_cast<int>(i % 40) - 20));
    maps.flat.push_back(1 + 0.01f * static_cast<float>(i % 7));
    maps.bad.push_back(i % 5 == 0);
  }
  return maps;
}

std::string slurp(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

std::string read_error(const std::filesystem::path& file) {
  try {
    read_sensor_maps(file);
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::file);
    EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos) << "one line";
    EXPECT_EQ(std::string(e.what()).rfind(file.string() + ": ", 0), 0u) << e.what();
    return e.what();
  }
  return "no error";
}

std::string validation_error(const SensorMaps& maps) {
  try {
    maps.validate();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::input);
    return e.what();
  }
  return "no error";
}

void expect_equal(const SensorMaps& a, const SensorMaps& b) {
  EXPECT_EQ(a.width, b.width);
  EXPECT_EQ(a.height, b.height);
  EXPECT_EQ(a.layout, b.layout);
  EXPECT_EQ(a.offset, b.offset);
  EXPECT_EQ(a.dark_rate, b.dark_rate);
  EXPECT_EQ(a.flat, b.flat);
  EXPECT_EQ(a.bad, b.bad);
  EXPECT_EQ(a.flat_sigma, b.flat_sigma);
  EXPECT_EQ(a.offset_sigma, b.offset_sigma);
  EXPECT_EQ(a.dark_rate_sigma, b.dark_rate_sigma);
}

TEST(SensorMaps, EveryLayoutAndEveryChoiceOfMapsComesBackBitByBit) {
  const test::TemporaryFolder folder;
  for (const auto layout : {PixelLayout::mono, PixelLayout::rgb, PixelLayout::bayer_rggb, PixelLayout::bayer_bggr})
    for (int choice = 1; choice < 16; ++choice) {
      SensorMaps maps = sample(layout, 13, 7);
      if (!(choice & 1)) maps.offset.clear();
      if (!(choice & 2)) maps.dark_rate.clear();
      if (!(choice & 4)) maps.flat.clear();
      if (!(choice & 8)) maps.bad.clear();
      write_sensor_maps(folder / "maps.exr", maps);
      expect_equal(read_sensor_maps(folder / "maps.exr"), maps);
    }
}

TEST(SensorMaps, EmptyMeansThatThereIsNothingToCorrect) {
  EXPECT_TRUE(SensorMaps{}.empty());
  SensorMaps maps = sample(PixelLayout::mono, 2, 2);
  EXPECT_FALSE(maps.empty());
  maps.offset.clear(), maps.dark_rate.clear(), maps.flat.clear();
  EXPECT_FALSE(maps.empty()) << "bad values are left";
  maps.bad.clear();
  EXPECT_TRUE(maps.empty());
  const test::TemporaryFolder folder;
  EXPECT_THROW(write_sensor_maps(folder / "maps.exr", maps), Error);
  EXPECT_FALSE(std::filesystem::exists(folder / "maps.exr"));
}

TEST(SensorMaps, EachFaultIsNamedWithItsField) {
  const struct {
    const char* field;
    void (*break_it)(SensorMaps&);
  } cases[] = {
      {"size", [](SensorMaps& m) { m.width = 0; }},
      {"offset: expected 12", [](SensorMaps& m) { m.offset.pop_back(); }},
      {"dark_rate: expected 12", [](SensorMaps& m) { m.dark_rate.push_back(0); }},
      {"flat: expected 12", [](SensorMaps& m) { m.flat.resize(3); }},
      {"bad: expected 12", [](SensorMaps& m) { m.bad.resize(1); }},
      {"value 3: offset", [](SensorMaps& m) { m.offset[3] = std::numeric_limits<float>::quiet_NaN(); }},
      {"value 4: dark_rate", [](SensorMaps& m) { m.dark_rate[4] = std::numeric_limits<float>::infinity(); }},
      {"value 2: flat", [](SensorMaps& m) { m.flat[2] = 0; }},
      {"value 1: flat", [](SensorMaps& m) { m.flat[1] = -1; }},
      {"value 7: bad", [](SensorMaps& m) { m.bad[7] = 2; }},
      {"flat_sigma", [](SensorMaps& m) { m.flat_sigma = -1; }},
      {"offset_sigma", [](SensorMaps& m) { m.offset_sigma = std::nan(""); }},
      {"dark_rate_sigma", [](SensorMaps& m) { m.dark_rate_sigma = std::numeric_limits<double>::infinity(); }},
  };
  for (const auto& c : cases) {
    SensorMaps maps = sample(PixelLayout::mono, 4, 3);
    maps.validate();
    c.break_it(maps);
    EXPECT_NE(validation_error(maps).find(c.field), std::string::npos) << c.field << ": " << validation_error(maps);
  }
}

TEST(SensorMaps, FramesOfAnotherSizeOrLayoutAreRefused) {
  const SensorMaps maps = sample(PixelLayout::bayer_rggb, 4, 3);
  EXPECT_NO_THROW(maps.validate(4, 3, PixelLayout::bayer_rggb));
  EXPECT_THROW(maps.validate(5, 3, PixelLayout::bayer_rggb), Error);
  EXPECT_THROW(maps.validate(4, 2, PixelLayout::bayer_rggb), Error);
  EXPECT_THROW(maps.validate(4, 3, PixelLayout::bayer_bggr), Error);
}

TEST(SensorMaps, MissingForeignAndTruncatedFilesGiveOneClearLine) {
  const test::TemporaryFolder folder;
  EXPECT_NE(read_error(folder / "none.exr").find("no such file"), std::string::npos);
  test::write_file(folder / "text.exr", "not an image");
  EXPECT_NE(read_error(folder / "text.exr"), "no error");
  write_radiance(folder / "radiance.exr", {1, 1, PixelLayout::mono, {2.5f}, {0.125f}, {PixelFlag::dark}});
  EXPECT_NE(read_error(folder / "radiance.exr").find("not sensor maps"), std::string::npos);
  write_sensor_maps(folder / "maps.exr", sample(PixelLayout::mono, 5, 3));
  const std::string whole = slurp(folder / "maps.exr");
  for (std::size_t n = 0; n < whole.size(); n += 7) {
    test::write_file(folder / "cut.exr", whole.substr(0, n));
    EXPECT_NE(read_error(folder / "cut.exr"), "no error") << n << " of " << whole.size() << " bytes";
  }
}

/// The file with the bytes behind `pattern`, which occurs once, replaced.
void patch(const std::filesystem::path& file, const std::string& pattern, const std::string& bytes) {
  std::string content = slurp(file);
  const std::size_t at = content.find(pattern);
  ASSERT_NE(at, std::string::npos);
  content.replace(at + pattern.size(), bytes.size(), bytes);
  test::write_file(file, content);
}

template <typename T>
std::string bytes_of(std::initializer_list<T> values) {
  std::string bytes;
  for (const T v : values) bytes.append(reinterpret_cast<const char*>(&v), sizeof(T));
  return bytes;
}

TEST(SensorMaps, HostileHeadersAreRefusedBeforeAnythingIsAllocated) {
  const test::TemporaryFolder folder;
  const auto file = folder / "maps.exr";
  for (const auto& [x, y] : {std::pair{5, 2}, {4, 3}, {30000, 2}, {2, 30000}, {8000, 8000}, {0x7ffffff0, 2}}) {
    write_sensor_maps(file, sample(PixelLayout::mono, 5, 3));
    patch(file, std::string("dataWindow\0box2i\0", 17), bytes_of<std::int32_t>({16, 0, 0, x, y}));
    EXPECT_NE(read_error(file), "no error") << x << " x " << y;
  }
  write_sensor_maps(file, sample(PixelLayout::mono, 5, 3));
  patch(file, std::string("lacquer.maps_version\0int\0", 25), bytes_of<std::int32_t>({4, 9}));
  EXPECT_NE(read_error(file).find("lacquer.maps_version: expected 1, got 9"), std::string::npos);
  write_sensor_maps(file, sample(PixelLayout::mono, 5, 3));
  patch(file, std::string("lacquer.flat_sigma\0double\0", 26), bytes_of<std::int32_t>({8}) + bytes_of<double>({-1.0}));
  EXPECT_NE(read_error(file).find("lacquer.flat_sigma"), std::string::npos);
}

TEST(SensorMaps, NonsenseValuesAreNamedWithTheirPixel) {
  const test::TemporaryFolder folder;
  const auto file = folder / "maps.exr";
  // One mono pixel: Y.bad, Y.dark_rate, Y.flat, Y.offset, in alphabetical order, are the last sixteen bytes (OpenEXR file layout).
  const auto with = [&](std::size_t from_end, const std::string& bytes) {
    write_sensor_maps(file, {1, 1, PixelLayout::mono, {2}, {3}, {1.5f}, 0, {0}, 0, 0});
    std::string content = slurp(file);
    content.replace(content.size() - from_end, 4, bytes);
    test::write_file(file, content);
    return read_error(file);
  };
  EXPECT_EQ(with(4, bytes_of<float>({2})), "no error");
  EXPECT_NE(with(4, bytes_of<float>({std::nanf("")})).find("pixel (0, 0): offset"), std::string::npos);
  EXPECT_NE(with(8, bytes_of<float>({0})).find("pixel (0, 0): flat"), std::string::npos);
  EXPECT_NE(with(12, bytes_of<float>({std::numeric_limits<float>::infinity()})).find("pixel (0, 0): dark_rate"), std::string::npos);
  EXPECT_NE(with(16, bytes_of<std::uint32_t>({256})).find("pixel (0, 0): bad"), std::string::npos);
}

}  // namespace
}  // namespace lacquer::calib
