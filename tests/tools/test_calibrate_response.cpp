#include <cmath>
#include <nlohmann/json.hpp>
#include <random>

#include "libacquire/frame.h"
#include "libcalib/response.h"
#include "test_support.h"

namespace {

using lacquer::test::run_lacquer;
using lacquer::test::TemporaryFolder;

/// Six frames of 4 to 128 ms and list.csv; value = 255 or 4095 times (exposure)^(1/gamma), with 1 % noise.
void write_bracket(const TemporaryFolder& folder, double gamma, int bits, int shift = 0, double false_factor = 1) {
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal(0, 0.01);
  std::string list = "file,exposure_s\n";
  const double top = std::exp2(bits) - 1;
  for (int j = 0; j < 6; ++j) {
    const double time = 0.004 * std::exp2(j);
    lacquer::acquire::RawFrame f{64, 48, lacquer::acquire::PixelLayout::mono, bits + shift, {}, {time, 0}};
    for (int i = 0; i < 64 * 48; ++i) {
      const double exposure = std::exp(-2.0 + 6.0 * i / (64 * 48)) * time * (1 + normal(random));
      f.data.push_back(static_cast<std::uint16_t>(static_cast<int>(std::lround(top * std::min(1.0, std::pow(exposure, 1 / gamma)))) << shift));
    }
    const std::string name = "f" + std::to_string(j) + ".tiff";
    lacquer::acquire::write_frame((folder / name).string(), f);
    list += name + "," + std::to_string(j == 3 ? time * false_factor : time) + "\n";
  }
  lacquer::test::write_file(folder / "list.csv", list);
}

std::string arguments(const TemporaryFolder& folder, const std::string& more) {
  return "calibrate response --frames " + (folder / "list.csv").string() + " -o " + (folder / "r.json").string() + " " + more;
}

TEST(CalibrateResponse, ACurveIsWrittenWithBandAndPlot) {
  const TemporaryFolder folder;
  write_bracket(folder, 2.2, 8);
  const auto result = run_lacquer(arguments(folder, "--plot " + (folder / "r.svg").string()));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.out.find("Y: curved"), std::string::npos) << result.out;
  EXPECT_NE(result.out.find("response: curve"), std::string::npos) << result.out;
  const auto response = lacquer::calib::read_response(folder / "r.json");
  EXPECT_FALSE(response.linear);
  EXPECT_FALSE(response.curves[0].band_value.empty());
  EXPECT_NEAR(response.curves[0].exposure[200] / response.curves[0].exposure[100], std::pow(2, 2.2), 0.05);
  EXPECT_TRUE(std::filesystem::file_size(folder / "r.svg") > 1000);
}

TEST(CalibrateResponse, ALinearSensorIsSaidToBeOneInJson) {
  const TemporaryFolder folder;
  write_bracket(folder, 1, 12);
  const auto result = run_lacquer(arguments(folder, "--bits 12 --json"));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const auto j = nlohmann::json::parse(result.out);
  EXPECT_TRUE(j["linear"].get<bool>());
  EXPECT_TRUE(j["channels"][0]["linear"].get<bool>());
  EXPECT_NEAR(j["black_level_dn"]["fitted"].get<double>(), 0, 1);
  EXPECT_EQ(j["times"][0]["false_frames"].size(), 0u);
  EXPECT_TRUE(lacquer::calib::read_response(folder / "r.json").linear);
}

TEST(CalibrateResponse, AFalseTimeIsRefusedByNameAndFittedOnRequest) {
  const TemporaryFolder folder;
  write_bracket(folder, 2.2, 8, 0, 1.5);
  const auto refused = run_lacquer(arguments(folder, ""));
  EXPECT_EQ(refused.exit_code, 1);
  EXPECT_NE(refused.err.find("list.csv: frame 4 (f3.tiff): listed 0.048 s, the pixels say 0.032"), std::string::npos) << refused.err;
  EXPECT_FALSE(std::filesystem::exists(folder / "r.json"));
  const auto fitted = run_lacquer(arguments(folder, "--fit-times"));
  EXPECT_EQ(fitted.exit_code, 0) << fitted.err;
  EXPECT_NE(fitted.out.find("frame 4: listed 0.048 s, fitted 0.03"), std::string::npos) << fitted.out;
}

TEST(CalibrateResponse, LeftAlignedValuesAreShiftedWithAStatement) {
  const TemporaryFolder folder;
  write_bracket(folder, 1.8, 12, 4);
  const auto result = run_lacquer(arguments(folder, "--bits 16"));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.err.find("multiples of 16: 12 bits stored left-aligned"), std::string::npos) << result.err;
  EXPECT_EQ(lacquer::calib::read_response(folder / "r.json").bits, 12);
}

TEST(CalibrateResponse, BadInputIsOneLine) {
  const TemporaryFolder folder;
  write_bracket(folder, 2.2, 8);
  EXPECT_EQ(run_lacquer("calibrate response -o x.json").exit_code, 2);
  EXPECT_EQ(run_lacquer(arguments(folder, "--plot r.pdf")).exit_code, 2);
  // A float picture, NaN in it or not, is no raw frame: a TIFF of two 32-bit float samples.
  std::string tiff("II*\0\x10\0\0\0\0\0\xc0\x7f\0\0\xc0\x7f", 16);
  const auto entry = [&](int tag, int type, int value) {
    for (const int x : {tag, type}) tiff += {static_cast<char>(x & 255), static_cast<char>(x >> 8)};
    for (const int x : {1, value}) tiff += {static_cast<char>(x & 255), static_cast<char>(x >> 8), '\0', '\0'};
  };
  tiff += std::string("\x0b\0", 2);
  for (const auto& [tag, type, value] : {std::array{256, 3, 2}, {257, 3, 1}, {258, 3, 32}, {259, 3, 1}, {262, 3, 1}, {273, 4, 8}, {277, 3, 1},
                                         {278, 3, 1}, {279, 4, 8}, {284, 3, 1}, {339, 3, 3}})
    entry(tag, type, value);
  tiff += std::string(4, '\0');
  lacquer::test::write_file(folder / "nan.tiff", tiff);
  lacquer::test::write_file(folder / "list.csv", "file,exposure_s\nnan.tiff,1\nf0.tiff,2\n");
  const auto result = run_lacquer("--quiet " + arguments(folder, "--bits 16"));
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("nan.tiff"), std::string::npos) << result.err;
  EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
}

}  // namespace
