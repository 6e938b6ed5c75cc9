#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>

#include "libacquire/session.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "test_support.h"

/// Every fault that a device, the program or a person can cause in the middle of a capture: the rig ends safe, the error is one line that
/// says what happened, and resuming with a rig that works gives the bytes of a capture without fault. docs/capture.md has the table.
namespace lacquer::acquire {
namespace {

namespace fs = std::filesystem;

constexpr const char* rig_text = R"([rig]
name = "faults"
kind = "simulated"
[camera]
width_px = 8
height_px = 6
layout = "grbg"
bits = 12
focal_length_px = 30
position_mm = [0, 0, 1000]
[sensor]
sensitivity_e_per_s = 1
[[lights]]
position_mm = [0, 100, 500]
[[lights]]
position_mm = [0, 200, 500]
[plan]
angles_deg = [0, 10, 20]
exposures_ms = [1, 2, 5]
)";
constexpr std::size_t n_frames = 18;

/// The devices of one rig, their log, and what goes wrong.
struct World {
  std::vector<std::string> events;
  int lit = -1, n_captures = 0, n_moves = 0, n_switches = 0;
  double angle = 0;
  std::function<void(int n, RawFrame&)> at_capture;  ///< n: captures before
  std::function<double(int n, double)> at_move;
  std::function<void(int n)> at_switch;
};

class FaultyTurntable final : public Turntable {
 public:
  explicit FaultyTurntable(World& world) : world_(world) {}
  void hold() noexcept override { world_.events.push_back("hold"); }
  std::string description() const override { return "table"; }

 private:
  double do_move_to(double angle) override {
    world_.events.push_back("move");
    const int n = world_.n_moves++;
    return world_.angle = world_.at_move ? world_.at_move(n, angle) : angle;
  }
  World& world_;
};

class FaultyLights final : public LightSwitch {
 public:
  explicit FaultyLights(World& world) : world_(world) {}
  void off() noexcept override { world_.events.push_back("off"); }
  std::string description() const override { return "lights"; }
  int n_lights() const override { return 2; }

 private:
  void do_on(int index) override {
    world_.events.push_back("on");
    world_.lit = index;
    if (world_.at_switch) world_.at_switch(world_.n_switches);
    ++world_.n_switches;
  }
  World& world_;
};

/// A frame depends on what it is a picture of only.
class FaultyCamera final : public Camera {
 public:
  explicit FaultyCamera(World& world) : world_(world) {}
  std::string description() const override { return "camera"; }

 private:
  RawFrame do_capture(const CaptureSettings& asked) override {
    RawFrame frame{.width = 8, .height = 6, .layout = PixelLayout::bayer_grbg, .bits = 12, .data = {}, .actual = asked};
    for (int i = 0; i < 48; ++i)
      frame.data.push_back(static_cast<std::uint16_t>(100 * world_.lit + i + std::lround(world_.angle * 1e3 + asked.exposure_s * 1e5)));
    const int n = world_.n_captures++;
    if (world_.at_capture) world_.at_capture(n, frame);
    return frame;
  }
  World& world_;
};

/// Of all frames, the record of each but for the moment it was taken.
std::map<std::string, std::string> frames_of(const fs::path& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder / "frames")) files[entry.path().filename()] = brdf::file_checksum(entry.path());
  return files;
}

class CaptureFaults : public testing::Test {
 protected:
  CaptureFaults() {
    World good;
    capture(good, folder / "undisturbed", false);
    expected = frames_of(folder / "undisturbed");
    EXPECT_EQ(expected.size(), n_frames);
  }
  Session capture(World& world, const fs::path& into, bool resume, const Progress& progress = {}, const FrameSink& sink = {}) {
    Rig rig;
    rig.turntable = std::make_unique<FaultyTurntable>(world);
    rig.lights = std::make_unique<FaultyLights>(world);
    rig.camera = std::make_unique<FaultyCamera>(world);
    const Session session = capture_session(rig, parse_rig(rig_text, folder / "rig.toml"), into, {"lacquer capture", resume, {}}, progress, sink);
    return session;
  }
  /// The capture ends with this text; then the session is resumed without fault. `n_kept`: frames that need not be taken again, at least.
  void expect_fault(World world, ErrorCode code, const std::string& text, int n_kept, const Progress& progress = {}, const FrameSink& sink = {}) {
    SCOPED_TRACE(text);
    const fs::path session = folder / "session";
    try {
      capture(world, session, false, progress, sink);
      FAIL() << "no error";
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), code);
      EXPECT_NE(std::string(e.what()).find(text), std::string::npos) << e.what();
      EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos) << "one line";
    }
    // Safe at the end, and nothing after that.
    ASSERT_GE(world.events.size(), 2u);
    const std::size_t last_action = std::max(last_of(world, "on"), last_of(world, "move"));
    EXPECT_GT(last_of(world, "off"), last_action);
    EXPECT_GT(last_of(world, "hold"), last_action);
    EXPECT_FALSE(fs::exists(session / "session.json"));

    World healthy;
    const Session resumed = capture(healthy, session, true);
    EXPECT_EQ(frames_of(session), expected) << "frames lost or changed";
    EXPECT_LE(healthy.n_captures, static_cast<int>(n_frames) - n_kept) << "frames that were safe were taken again";
    for (const ViewRecord& view : resumed.views)
      for (const FrameRecord& frame : view.frames) EXPECT_NO_THROW(read_session_frame(resumed, frame));
    EXPECT_FALSE(fs::exists(session / "capture.jsonl"));
    fs::remove_all(session);
  }
  static std::size_t last_of(const World& world, const std::string& event) {
    std::size_t last = 0;
    for (std::size_t i = 0; i < world.events.size(); ++i)
      if (world.events[i] == event) last = i + 1;
    return last;
  }
  void expect_camera_fault(const std::function<void(RawFrame&)>& fault, ErrorCode code, const std::string& text) {
    for (const int at : {0, 7, 17}) {
      World world;
      world.at_capture = [&](int n, RawFrame& frame) {
        if (n == at) fault(frame);
      };
      expect_fault(world, code, text, at);
    }
  }
  void expect_table_fault(const std::function<double(double)>& fault, ErrorCode code, const std::string& text) {
    for (const int at : {0, 3, 5}) {
      World world;
      world.at_move = [&](int n, double angle) { return n == at ? fault(angle) : angle; };
      expect_fault(world, code, text, 3 * at);
    }
  }

  test::TemporaryFolder folder;
  std::map<std::string, std::string> expected;
};

TEST_F(CaptureFaults, CameraGivesNoFrame) {
  expect_camera_fault([](RawFrame&) { throw Error(ErrorCode::timeout, "camera: no frame within 2 s of the exposure of 0.001 s"); }, ErrorCode::timeout,
                      "camera: no frame within 2 s");
}

TEST_F(CaptureFaults, CameraIsUnplugged) {
  expect_camera_fault([](RawFrame&) { throw Error(ErrorCode::device, "camera: unplugged"); }, ErrorCode::device, "camera: unplugged");
}

TEST_F(CaptureFaults, CameraReturnsAnImpossibleFrame) {
  const std::string returned = "camera: the camera returned an impossible frame: ";
  expect_camera_fault([](RawFrame& f) { f.data[5] = 4096; }, ErrorCode::device, returned + "a value beyond 12 bits (is the data left-aligned?)");
  expect_camera_fault([](RawFrame& f) { f.data.pop_back(); }, ErrorCode::device, returned + "47 values, expected 48");
  expect_camera_fault([](RawFrame& f) { f.width = 0; }, ErrorCode::device, returned + "frame size 0 x 6");
  expect_camera_fault([](RawFrame& f) { f.actual.exposure_s = std::nan(""); }, ErrorCode::device, returned + "exposure time read back as nan s");
}

TEST_F(CaptureFaults, CameraReturnsAnotherFormat) {
  expect_camera_fault([](RawFrame& f) { std::swap(f.width, f.height); }, ErrorCode::file, "of camera: 6 x 8 pixels; expected 8 x 6 as in the rig file");
  expect_camera_fault([](RawFrame& f) { f.layout = PixelLayout::mono; }, ErrorCode::file, "of camera: pixel layout mono; expected grbg as in the rig file");
  expect_camera_fault([](RawFrame& f) { f.bits = 16; }, ErrorCode::file, "of camera: 16 bits; expected 12 as in the rig file");
}

TEST_F(CaptureFaults, CameraTakesAnotherExposureOrGain) {
  expect_camera_fault([](RawFrame& f) { f.actual.exposure_s += 0.5; }, ErrorCode::device, "s, asked were 0.0");
  expect_camera_fault([](RawFrame& f) { f.actual.gain_db = 6; }, ErrorCode::device, "gain read back as 6 dB, asked were 0 dB");
}

TEST_F(CaptureFaults, TurntableStallsOrIsUnplugged) {
  expect_table_fault([](double) -> double { throw Error(ErrorCode::timeout, "table: did not reach 10 deg within 3 s"); }, ErrorCode::timeout, "did not reach");
  expect_table_fault([](double) -> double { throw Error(ErrorCode::device, "table: no such device (it may have been disconnected)"); }, ErrorCode::device,
                     "disconnected");
}

TEST_F(CaptureFaults, TurntableReadsBackNoAngle) {
  expect_table_fault([](double) { return std::numeric_limits<double>::infinity(); }, ErrorCode::device, "table: angle read back as inf after a move to");
}

TEST_F(CaptureFaults, LightCannotBeSwitched) {
  for (const int at : {0, 3, 5}) {
    World world;
    world.at_switch = [&](int n) {
      if (n == at) throw Error(ErrorCode::device, "gpiochip0 line 17: cannot be used as an output: Device or resource busy (\"fan\")");
    };
    expect_fault(world, ErrorCode::device, "line 17: cannot be used as an output", 3 * at);
  }
}

TEST_F(CaptureFaults, CtrlC) {
  for (std::size_t at = 0; at <= n_frames; ++at)
    expect_fault({}, ErrorCode::interrupted, "interrupted", static_cast<int>(at), [&](const std::string&, std::size_t done, std::size_t) {
      if (done == at) throw Error(ErrorCode::interrupted, "interrupted");
    });
}

TEST_F(CaptureFaults, MergingFails) {
  int n = 0;
  FrameSink sink;
  sink.frame = [&](const ViewRecord&, const RawFrame&) {
    if (n++ == 4) throw Error(ErrorCode::input, "frame cannot be merged");
  };
  expect_fault({}, ErrorCode::input, "frame cannot be merged", 5, {}, sink);  // the frame itself is safe on disk
}

TEST_F(CaptureFaults, FolderOfFramesVanishesMeanwhile) {
  World world;
  world.at_capture = [&](int n, RawFrame&) {
    if (n == 6) fs::rename(folder / "session/frames", folder / "session/lost");
  };
  expect_fault(world, ErrorCode::file, "session/frames/L00", 0);  // which frame was to be written next is the writer's affair
}

TEST_F(CaptureFaults, FolderThatCannotBeWrittenIsSaidBeforeAnythingMoves) {
  World world;
  try {
    capture(world, "/proc/lacquer-session", false);
    FAIL() << "no error";
  } catch (const Error& e) {
    EXPECT_EQ(std::string(e.what()).find("/proc/lacquer-session: cannot be created: "), 0u) << e.what();
  }
  EXPECT_EQ(world.n_moves + world.n_switches + world.n_captures, 0);
}

TEST_F(CaptureFaults, CheckThatFailsLeavesAFolderForANewCapture) {
  World world;
  Rig rig;
  rig.turntable = std::make_unique<FaultyTurntable>(world);
  rig.lights = std::make_unique<FaultyLights>(world);
  rig.camera = std::make_unique<FaultyCamera>(world);
  CaptureOptions options;
  options.before_frames = [](Rig&) { throw Error(ErrorCode::device, "camera: not linear"); };
  EXPECT_THROW(capture_session(rig, parse_rig(rig_text, folder / "rig.toml"), folder / "session", options, {}), Error);
  EXPECT_EQ(world.n_captures, 0);
  World good;
  capture(good, folder / "session", false);
  EXPECT_EQ(frames_of(folder / "session"), expected);
}

// Killed between writing session.json and removing the journal: seen once in some thousand kills.
TEST_F(CaptureFaults, JournalThatOutlivedItsSessionGoes) {
  test::write_file(folder / "undisturbed/capture.jsonl", "{}\n");
  World world;
  capture(world, folder / "undisturbed", true);
  EXPECT_EQ(world.n_captures, 0);
  EXPECT_FALSE(fs::exists(folder / "undisturbed/capture.jsonl"));
}

}  // namespace
}  // namespace lacquer::acquire
