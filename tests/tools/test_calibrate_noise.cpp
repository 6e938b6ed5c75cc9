#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "libacquire/frame.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libcalib/noise_json.h"
#include "libcalib/photon_transfer_support.h"
#include "libcalib/sensor_maps.h"
#include "test_support.h"

namespace lacquer {
namespace {

using acquire::PixelLayout;
using acquire::RawFrame;
using test::run_lacquer;

test::SimulatedSensor sensor() {
  test::SimulatedSensor s;
  s.description.layout = PixelLayout::bayer_rggb;
  s.description.bits = 12;
  s.description.black_level_dn = 64;
  s.description.gain_e_per_dn = 2;
  s.description.read_noise_e = 5;
  s.description.dark_current_e_per_s = 20;
  s.description.sensitivity = {1500, 2000, 1200};
  s.flaws = {.prnu = 0.02, .dsnu_e = 20, .dark_nonuniformity = 0.3, .hot_pixels = 0.002, .dead_pixels = 0.002};
  s.width = 96;
  s.height = 64;
  return s;
}

void write_list(const test::TemporaryFolder& folder, const std::string& name, const std::vector<RawFrame>& frames) {
  std::string list = "file,exposure_s\n";
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const std::string file = fmt::format("{}{}.tiff", name, i);
    acquire::write_frame((folder / file).string(), frames[i]);
    list += fmt::format("{},{}\n", file, frames[i].actual.exposure_s);
  }
  test::write_file(folder / (name + ".csv"), list);
}

void write_darks(const test::TemporaryFolder& folder) {
  write_list(folder, "darks", sensor().frames(test::repeated({0.1, 1, 4, 8}, 4), {0.0}, 1));
}

void write_flats(const test::TemporaryFolder& folder) {
  write_list(folder, "flats", sensor().frames(test::repeated({0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 2.4, 3.2, 5}, 2), {1.0}, 2));
}

std::string arguments(const test::TemporaryFolder& folder, const std::string& more) {
  return "calibrate noise -o " + (folder / "noise.json").string() + " --bits 12 --layout rggb " + more;
}

TEST(CalibrateNoise, ListsOfDarksAndFlatsGiveModelMapsAndPlot) {
  const test::TemporaryFolder folder;
  write_darks(folder);
  write_flats(folder);
  const auto result = run_lacquer(arguments(folder, "--darks " + (folder / "darks.csv").string() + " --flats " + (folder / "flats.csv").string() +
                                                        " --maps " + (folder / "maps.exr").string() + " --plot " + (folder / "plot.svg").string()));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  for (const char* text : {"96 x 64 rggb, 12 bits", "black level", "e-/DN", "±", "one gain for all", "saturation: 4095 DN", "bad values: "})
    EXPECT_NE(result.out.find(text), std::string::npos) << text << "\n" << result.out;

  const calib::NoiseModel noise = calib::read_noise_model(folder / "noise.json");
  const auto json = nlohmann::json::parse(brdf::read_text(folder / "noise.json"));
  const auto near = [&](double value, const char* field, double truth) {
    EXPECT_NEAR(value, truth, 4 * json["all"][field]["sigma"].get<double>()) << field;
    EXPECT_EQ(json["all"][field]["value"].get<double>(), value) << field;
  };
  near(noise.gain_e_per_dn, "gain_e_per_dn", 2);
  near(noise.read_noise_e, "read_noise_e", 5);
  EXPECT_NEAR(noise.dark_current_e_per_s, 20, 1);
  EXPECT_EQ(noise.saturation_dn, 4095);
  EXPECT_EQ(json["channels"].size(), 3u);
  EXPECT_EQ(json["points"].size(), 3u * (8 + 10));
  EXPECT_EQ(json["provenance"]["inputs"].size(), 2u + 16 + 20) << "every frame's checksum is recorded";

  const calib::SensorMaps maps = calib::read_sensor_maps(folder / "maps.exr");
  maps.validate(96, 64, PixelLayout::bayer_rggb);
  const auto model = sensor().model();
  for (std::size_t i = 0; i < maps.bad.size(); ++i)
    EXPECT_EQ(maps.bad[i] != 0, model.dark_current(i) > 1000 || model.relative_sensitivity(i) == 0) << i;
  EXPECT_NE(brdf::read_text(folder / "plot.svg").find("<svg"), std::string::npos);
}

TEST(CalibrateNoise, DarksAloneAreReportedButAreNoModelToMergeWith) {
  const test::TemporaryFolder folder;
  write_darks(folder);
  const auto result = run_lacquer(arguments(folder, "--darks " + (folder / "darks.csv").string()));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.out.find("note: no flats"), std::string::npos) << result.out;
  try {
    calib::read_noise_model(folder / "noise.json");
    FAIL() << "a model without a gain";
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("noise.gain_e_per_dn: expected a measured gain"), std::string::npos) << e.what();
  }
}

TEST(CalibrateNoise, BadListsAndOptionsGiveOneLine) {
  const test::TemporaryFolder folder;
  const auto check = [&](const std::string& more, int exit_code, const std::string& part) {
    const auto result = run_lacquer("-q " + arguments(folder, more));
    EXPECT_EQ(result.exit_code, exit_code) << more;
    EXPECT_NE(result.err.find(part), std::string::npos) << result.err;
    EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
    EXPECT_FALSE(std::filesystem::exists(folder / "noise.json"));
  };
  auto frames = sensor().frames({1, 1}, {0.0}, 1);
  frames.push_back(RawFrame{8, 8, PixelLayout::bayer_rggb, 12, std::vector<std::uint16_t>(64, 64), {1, 0}});
  write_list(folder, "mixed", frames);
  check("--darks " + (folder / "mixed.csv").string(), 1, "mixed.csv:4: " + (folder / "mixed2.tiff").string() + ": is 8 x 8 rggb of 12 bits");
  check("", 2, "expected --darks list.csv, --flats list.csv or both");
  check("--darks " + (folder / "none.csv").string(), 1, "none.csv");
  check("--darks " + (folder / "mixed.csv").string() + " --plot picture.gif", 2, "picture.gif");
  write_flats(folder);
  check("--flats " + (folder / "flats.csv").string(), 1, "black level");
}

}  // namespace
}  // namespace lacquer
