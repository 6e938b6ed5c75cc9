#include <gtest/gtest.h>

#include <filesystem>

#include "libacquire/capture_estimate.h"
#include "libacquire/open_rig.h"
#include "libacquire/session.h"
#include "libbrdf/brdf.h"
#include "test_support.h"

namespace lacquer::acquire {
namespace {

std::string rig_text(const std::string& kind, int width, int height, int bits, const std::string& plan) {
  return "[rig]\nname = \"x\"\nkind = \"" + kind + "\"\n[camera]\nwidth_px = " + std::to_string(width) + "\nheight_px = " + std::to_string(height) +
         "\nlayout = \"mono\"\nbits = " + std::to_string(bits) +
         "\nfocal_length_px = 150\nposition_mm = [0, 0, 1000]\n[sensor]\nsensitivity_e_per_s = 1e5\n[[lights]]\nposition_mm = [0, 125, 587]\n"
         "[[lights]]\nposition_mm = [50, 300, 500]\n[plan]\n" + plan;
}

TEST(CaptureEstimate, MoveTakesTheTimeOfATrapezoid) {
  // 2 rad/s reached within 1 s and 1 rad at 2 rad/s^2, the same for braking: 10 rad are 2 s of ramps over 2 rad and 8 rad at 2 rad/s.
  EXPECT_DOUBLE_EQ(move_duration(10, 2, 2), 6);
  EXPECT_DOUBLE_EQ(move_duration(2, 2, 2), 2);  // just reaches it
  EXPECT_DOUBLE_EQ(move_duration(0.5, 2, 2), 1);  // 0.25 rad = 2/2 * 0.5^2 up, the same down
  EXPECT_DOUBLE_EQ(move_duration(0, 2, 2), 0);
}

TEST(CaptureEstimate, SimulatedDurationIsThatOfTheSimulatedClock) {
  test::TemporaryFolder folder;
  const RigDescription rig = parse_rig(rig_text("simulated", 24, 18, 12, "angles_deg = [20, 50, 0]\nexposures_ms = [1, 30]\n"), folder / "rig.toml");
  Rig devices = open_rig(rig, brdf::load_brdf(test::source_dir() / "data-samples/paints/white.json"));
  const Session session = capture_session(devices, rig, folder / "session", {}, {});
  const FrameRecord& last = session.views.back().frames.back();
  ASSERT_TRUE(last.time_s);
  const CaptureEstimate estimate = estimate_capture(rig);
  constexpr double readout = 0.04;  // SimulatedTiming: the one thing that comes after the last exposure
  EXPECT_NEAR(estimate.total_s(), *last.time_s + last.exposure_s + readout, 1e-9);
  EXPECT_NEAR(estimate.exposure_s, 6 * (0.001 + 0.030), 1e-12);
  EXPECT_EQ(estimate.n_views, 6u);
  EXPECT_EQ(estimate.n_frames, 12u);
}

TEST(CaptureEstimate, FilesAreAtMostAsLargeAsSaidAndHardlySmaller) {
  test::TemporaryFolder folder;
  for (const auto& [width, height, bits] : {std::tuple{24, 18, 12}, {640, 480, 8}, {1360, 1024, 16}}) {
    const RigDescription rig = parse_rig(rig_text("simulated", width, height, bits, "angles_deg = 0\nexposures_ms = [1]\n"), folder / "rig.toml");
    const RawFrame frame{.width = width, .height = height, .layout = PixelLayout::mono, .bits = bits,
                         .data = std::vector<std::uint16_t>(static_cast<std::size_t>(width * height)), .actual = {0.001, 0}};
    write_frame((folder / "frame.tiff").string(), frame);
    const auto real = std::filesystem::file_size(folder / "frame.tiff");
    EXPECT_GE(frame_file_bytes(rig), real);
    EXPECT_LE(frame_file_bytes(rig), real + 512 + 8 * static_cast<std::uintmax_t>(height));
  }
}

TEST(CaptureEstimate, HardwareTakesItsNumbersFromTheRigFile) {
  test::TemporaryFolder folder;
  const std::string devices =
      "[devices.camera]\nback_end = \"aravis\"\n[devices.turntable]\nback_end = \"tic\"\nmax_speed_deg_per_s = 10\n"
      "max_acceleration_deg_per_s2 = 20\nbacklash_deg = 5\nsettle_ms = 300\n[devices.lights]\nback_end = \"gpiod\"\nsettle_ms = 50\n"
      "lines = [{ line = \"A\" }, { line = \"B\" }]\nchip = \"gpiochip0\"\n";
  const RigDescription rig =
      parse_rig(rig_text("hardware", 1100, 1000, 16, "angles_deg = [0, 20, 10]\nexposures_ms = [10, 100]\n") + devices, folder / "rig.toml");
  const CaptureEstimate estimate = estimate_capture(rig);
  // 20 deg forward: 0.5 s + 20/10 s. 10 deg back with the backlash: 15 deg, 2 s, and 5 deg forward again, 1 s. Each time 0.3 s to settle.
  EXPECT_NEAR(estimate.motion_s, 2.5 + 0.3 + 2 + 1 + 0.3, 1e-9);
  EXPECT_NEAR(estimate.lights_s, 6 * 0.05, 1e-12) << "A and B in turn at each of three angles";
  EXPECT_NEAR(estimate.exposure_s, 6 * 0.11, 1e-12);
  EXPECT_NEAR(estimate.readout_s, 12 * (2.2e6 / 110e6 + 0.005), 1e-9);
  EXPECT_NEAR(estimate_capture(parse_rig(rig_text("hardware", 1100, 1000, 8, "angles_deg = 0\nexposures_ms = [10, 100]\nlights = [0]\n") +
                                             "[devices.camera]\nback_end = \"v4l2\"\nsettle_frames = 2\n[devices.turntable]\nback_end = \"fixed\"\n"
                                             "[devices.lights]\nback_end = \"gpiod\"\nchip = \"gpiochip0\"\nlines = [{ line = \"A\" }, { line = \"B\" }]\n",
                                         folder / "rig.toml")).readout_s,
              3 * (1.0 / 30) + 3 * 0.1, 1e-12) << "three periods of at least 1/30 s each";
}

}  // namespace
}  // namespace lacquer::acquire
