#include "libacquire/devices.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "libbrdf/error.h"

namespace lacquer::acquire {
namespace {

constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();
constexpr double infinite = std::numeric_limits<double>::infinity();

RawFrame good_frame() {
  return {.width = 3, .height = 2, .layout = PixelLayout::mono, .bits = 10, .data = std::vector<std::uint16_t>(6, 1023), .actual = {0.01, 0}};
}

class FakeCamera final : public Camera {
 public:
  RawFrame frame = good_frame();
  int n_captures = 0;
  std::string description() const override { return "fake camera 17"; }

 private:
  RawFrame do_capture(const CaptureSettings&) override {
    ++n_captures;
    return frame;
  }
};

struct Log {
  int n_off = 0, n_hold = 0, on = -1;
};

class FakeTable final : public Turntable {
 public:
  explicit FakeTable(Log& log) : log_(log) {}
  double read_back = 0.5;
  void hold() noexcept override { ++log_.n_hold; }
  std::string description() const override { return "fake table"; }

 private:
  double do_move_to(double) override { return read_back; }
  Log& log_;
};

class FakeLights final : public LightSwitch {
 public:
  explicit FakeLights(Log& log) : log_(log) {}
  void off() noexcept override { ++log_.n_off; }
  std::string description() const override { return "fake lights"; }
  int n_lights() const override { return 3; }

 private:
  void do_on(int index) override { log_.on = index; }
  Log& log_;
};

template <typename Call>
void expect_error(ErrorCode code, const std::string& part, const Call& call) {
  try {
    call();
    ADD_FAILURE() << "no error; expected one with \"" << part << "\"";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), code) << e.what();
    EXPECT_NE(std::string(e.what()).find(part), std::string::npos) << e.what();
    EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos) << e.what();
  }
}

TEST(Camera, GivesAGoodFrameThrough) {
  FakeCamera camera;
  EXPECT_EQ(camera.capture({0.01, 0}).data, good_frame().data);
}

TEST(Camera, AsksTheHardwareOnlyForPossibleSettings) {
  FakeCamera camera;
  for (const double exposure : {0.0, -1.0, not_a_number, infinite})
    expect_error(ErrorCode::usage, "fake camera 17: exposure", [&] { camera.capture({exposure, 0}); });
  expect_error(ErrorCode::usage, "gain", [&] { camera.capture({0.1, not_a_number}); });
  EXPECT_EQ(camera.n_captures, 0);
}

TEST(Camera, RefusesImpossibleFramesOfABackEnd) {
  const auto refused = [](const std::string& part, const auto& spoil) {
    FakeCamera camera;
    spoil(camera.frame);
    expect_error(ErrorCode::device, part, [&] { camera.capture({0.01, 0}); });
  };
  refused("5 values, expected 6", [](RawFrame& f) { f.data.pop_back(); });
  refused("frame size 0 x 2", [](RawFrame& f) { f.width = 0; });
  refused("17 bits", [](RawFrame& f) { f.bits = 17; });
  refused("beyond 10 bits", [](RawFrame& f) { f.data[4] = 1024; });
  refused("expected 18", [](RawFrame& f) { f.layout = PixelLayout::rgb; });
  refused("read back as 0 s", [](RawFrame& f) { f.actual.exposure_s = 0; });
  refused("gain read back", [](RawFrame& f) { f.actual.gain_db = not_a_number; });
}

TEST(Turntable, RefusesAnglesThatAreNoNumbers) {
  Log log;
  FakeTable table(log);
  EXPECT_EQ(table.move_to(1.0), 0.5);
  expect_error(ErrorCode::usage, "fake table: angle", [&] { table.move_to(not_a_number); });
  table.read_back = not_a_number;
  expect_error(ErrorCode::device, "read back as nan", [&] { table.move_to(1.0); });
}

TEST(LightSwitch, RefusesLightsThatAreNotThere) {
  Log log;
  FakeLights lights(log);
  lights.on(2);
  EXPECT_EQ(log.on, 2);
  expect_error(ErrorCode::usage, "light 3: expected 0..2", [&] { lights.on(3); });
  expect_error(ErrorCode::usage, "light -1", [&] { lights.on(-1); });
  EXPECT_EQ(log.on, 2);
}

Rig rig_with(Log& log) {
  Rig rig;
  rig.turntable = std::make_unique<FakeTable>(log);
  rig.lights = std::make_unique<FakeLights>(log);
  return rig;
}

TEST(Rig, LeavesLightsOffAndMotorHeldWhenAnExceptionPasses) {
  Log log;
  try {
    const Rig rig = rig_with(log);
    log = {};
    throw Error(ErrorCode::device, "camera lost");
  } catch (const Error&) {
  }
  EXPECT_EQ(log.n_off, 1);
  EXPECT_EQ(log.n_hold, 1);
}

TEST(Rig, MovedFromRigTouchesNothing) {
  Log log;
  Rig rig = rig_with(log);
  log = {};
  { const Rig moved = std::move(rig); }
  EXPECT_EQ(log.n_off, 1);
  EXPECT_EQ(log.n_hold, 1);
}

TEST(Rig, MakesTheOldDevicesSafeBeforeTakingOthers) {
  Log old_log, new_log;
  Rig rig = rig_with(old_log);
  Rig other = rig_with(new_log);
  old_log = new_log = {};
  rig = std::move(other);
  EXPECT_EQ(old_log.n_off, 1);
  EXPECT_EQ(old_log.n_hold, 1);
  EXPECT_EQ(new_log.n_off, 0);
}

}  // namespace
}  // namespace lacquer::acquire
