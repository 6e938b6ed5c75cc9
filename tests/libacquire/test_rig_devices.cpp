#include <gtest/gtest.h>

#include <numbers>

#include "libacquire/back_ends.h"
#include "libacquire/open_rig.h"
#include "libacquire/rig_description.h"
#include "libbrdf/error.h"
#include "test_support.h"

namespace lacquer::acquire {
namespace {

constexpr double degree = std::numbers::pi / 180;

/// A rig of hardware with `devices` at its end, two lights.
std::string rig_text(const std::string& camera, const std::string& turntable, const std::string& lights) {
  return R"(
[rig]
name = "bench"
kind = "hardware"
[camera]
width_px = 64
height_px = 48
layout = "rggb"
bits = 12
focal_length_px = 400
position_mm = [0, 0, 1000]
[[lights]]
name = "a"
position_mm = [0, 0, 600]
[[lights]]
name = "b"
position_mm = [0, 100, 600]
[plan]
angles_deg = [0, 90]
exposures_ms = [1, 10]
[devices.camera]
)" + camera + "\n[devices.turntable]\n" + turntable + "\n[devices.lights]\n" + lights + "\n";
}

const std::string good_camera = "back_end = \"aravis\"", good_turntable = "back_end = \"tic\"",
                  good_lights = "back_end = \"gpiod\"\nchip = \"gpiochip0\"\nlines = [{ offset = 17 }, { line = \"LED2\", active_low = true, chip = \"other\" }]";

std::string error_of(const std::string& text, bool open = false) {
  try {
    const RigDescription rig = parse_rig(text, "rig.toml");
    if (open) open_rig(rig, nullptr);
    return "no error";
  } catch (const Error& e) {
    return e.what();
  }
}

TEST(RigDevices, EveryKeyArrivesInSiUnits) {
  const auto rig = parse_rig(rig_text("back_end = \"v4l2\"\nid = \"/dev/video3\"\npixel_format = \"RG12\"\noffset_px = [10, 20]\ngain = 4\npacket_size = 9000\ntimeout_s = 5\n"
                                      "settle_frames = 4\nfixed_exposure_ms = 20",
                                      "back_end = \"tic\"\nserial = \"0012\"\nfull_steps_per_turn = 400\nmicrosteps = 32\ngear_ratio = 9.5\nreversed = true\n"
                                      "max_speed_deg_per_s = 90\nmax_acceleration_deg_per_s2 = 45\nbacklash_deg = 1\nmin_deg = -10\nmax_deg = 190\nhome = \"forward\"\n"
                                      "home_angle_deg = 190\nhome_timeout_s = 60\nsettle_ms = 300",
                                      good_lights + "\nsettle_ms = 250"),
                             "rig.toml");
  EXPECT_EQ(rig.kind, RigDescription::Kind::hardware);
  const auto& d = rig.devices;
  EXPECT_EQ(d.camera_back_end, "v4l2");
  EXPECT_EQ(d.camera.id, "/dev/video3");
  EXPECT_EQ(d.camera.pixel_format, "RG12");
  EXPECT_EQ(d.camera.width, 64);
  EXPECT_EQ(d.camera.height, 48);
  EXPECT_EQ(d.camera.layout, PixelLayout::bayer_rggb);
  EXPECT_EQ(d.camera.bits, 12);
  EXPECT_EQ(d.camera.offset_x, 10);
  EXPECT_EQ(d.camera.offset_y, 20);
  EXPECT_EQ(d.camera.gain, 4);
  EXPECT_EQ(d.camera.packet_size, 9000);
  EXPECT_EQ(d.camera.timeout_s, 5);
  EXPECT_EQ(d.camera.settle_frames, 4);
  EXPECT_DOUBLE_EQ(*d.camera.fixed_exposure_s, 0.02);
  const TicSettings& t = d.turntable;
  EXPECT_EQ(t.serial, "0012");
  EXPECT_EQ(t.full_steps_per_turn, 400);
  EXPECT_EQ(t.microsteps, 32);
  EXPECT_EQ(t.gear_ratio, 9.5);
  EXPECT_TRUE(t.reversed);
  EXPECT_DOUBLE_EQ(t.max_speed, 90 * degree);
  EXPECT_DOUBLE_EQ(t.max_acceleration, 45 * degree);
  EXPECT_DOUBLE_EQ(t.backlash, 1 * degree);
  EXPECT_DOUBLE_EQ(t.min_angle, -10 * degree);
  EXPECT_DOUBLE_EQ(t.max_angle, 190 * degree);
  EXPECT_EQ(t.home, TicSettings::Home::forward);
  EXPECT_DOUBLE_EQ(t.home_angle, 190 * degree);
  EXPECT_EQ(t.home_timeout_s, 60);
  EXPECT_DOUBLE_EQ(t.settle_s, 0.3);
  ASSERT_EQ(d.lights.lights.size(), 2u);
  EXPECT_EQ(d.lights.lights[0].chip, "gpiochip0");
  EXPECT_EQ(d.lights.lights[0].offset, 17u);
  EXPECT_FALSE(d.lights.lights[0].active_low);
  EXPECT_EQ(d.lights.lights[1].chip, "other");
  EXPECT_EQ(d.lights.lights[1].line, "LED2");
  EXPECT_TRUE(d.lights.lights[1].active_low);
  EXPECT_DOUBLE_EQ(d.lights.settle_s, 0.25);
}

TEST(RigDevices, MistakesAreNamed) {
  const auto camera = [](const std::string& more) { return error_of(rig_text(good_camera + "\n" + more, good_turntable, good_lights)); };
  const auto turntable = [](const std::string& more) { return error_of(rig_text(good_camera, good_turntable + "\n" + more, good_lights)); };
  const auto lights = [](const std::string& text) { return error_of(rig_text(good_camera, good_turntable, text)); };
  const auto expect = [](const std::string& error, const std::string& part) { EXPECT_NE(error.find(part), std::string::npos) << error; };
  expect(camera("pixelformat = \"Mono8\""), "[devices.camera]: unknown key \"pixelformat\"; did you mean \"pixel_format\"?");
  expect(camera("offset_px = [0.5, 0]"), "devices.camera.offset_px: expected whole numbers");
  expect(camera("packet_size = 100"), "devices.camera.packet_size");
  expect(turntable("gear_ratio = 0"), "devices.turntable.gear_ratio: expected a number from 0.001");
  expect(turntable("min_deg = 5\nmax_deg = 5"), "devices.turntable.max_deg: expected more than min_deg");
  expect(turntable("home = \"left\""), "devices.turntable.home: expected \"here\", \"reverse\" or \"forward\", got \"left\"");
  expect(turntable("home_angle_deg = 3"), "devices.turntable.home_angle_deg: only with home");
  expect(lights("back_end = \"gpiod\"\nchip = \"c\"\nlines = [{ offset = 1 }]"), "devices.lights.lines: expected one per light, 2 in the order of [[lights]], got 1");
  expect(lights("back_end = \"gpiod\"\nlines = [{ offset = 1 }, { offset = 2 }]"), "devices.lights.lines[0].chip: missing");
  expect(lights("back_end = \"gpiod\"\nchip = \"c\"\nlines = [{ offset = 1 }, { offset = 2, line = \"L\" }]"), "devices.lights.lines[1].line: expected either");
  expect(lights("chip = \"c\""), "devices.lights.back_end: missing");
  std::string simulated = rig_text(good_camera, good_turntable, good_lights);
  simulated.replace(simulated.find("\"hardware\""), 10, "\"simulated\"");
  EXPECT_NE(error_of(simulated), "no error");
  const std::string full = rig_text(good_camera, good_turntable, good_lights);
  expect(error_of(full.substr(0, full.find("[devices.camera]"))), "[devices]: missing");
  expect(error_of(full.substr(0, full.find("[devices.lights]"))), "[devices.lights]: missing");
}

TEST(RigDevices, UnknownBackEndIsSaidWithTheKnownOnes) {
  const std::string error = error_of(rig_text(good_camera, good_turntable, "back_end = \"relay\"\nchip = \"c\"\nlines = [{ offset = 1 }, { offset = 2 }]"), true);
  EXPECT_EQ(error, "rig.toml: devices.lights.back_end: expected \"gpiod\", got \"relay\"");
}

TEST(RigDevices, RigsOfTheRepositoryAreRead) {
  for (const char* file : {"rigs/bench.toml", "rigs/webcam.toml"}) {
    const auto rig = read_rig(test::source_dir() / file);
    EXPECT_EQ(rig.devices.lights.lights.size(), rig.geometry.lights.size());
    const auto& cameras = camera_back_ends();
    EXPECT_TRUE(std::any_of(cameras.begin(), cameras.end(), [&](const auto& row) { return row.name == rig.devices.camera_back_end; })) << file;
    for (const auto& view : rig.plan) {
      if (rig.devices.turntable_back_end != "tic") continue;
      EXPECT_GE(view.turntable_angle, rig.devices.turntable.min_angle);
      EXPECT_LE(view.turntable_angle, rig.devices.turntable.max_angle);
    }
  }
}

TEST(RigDevices, FixedTurntableStandsAtZero) {
  for (const auto& row : turntable_back_ends())
    if (row.name == "fixed") {
      const auto table = row.open({});
      EXPECT_EQ(table->move_to(0), 0);
      EXPECT_THROW(table->move_to(0.1), Error);
    }
}

}  // namespace
}  // namespace lacquer::acquire
