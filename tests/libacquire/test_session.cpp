#include <functional>

#include <gtest/gtest.h>

#include "libacquire/capture_clock.h"
#include "libacquire/session.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "test_support.h"

namespace lacquer::acquire {
namespace {

constexpr const char* rig_text = R"([rig]
name = "test"
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
name = "A"
position_mm = [0, 100, 500]
[[lights]]
name = "B"
direction = [0, 0, 1]
[plan]
angles_deg = [0, 10]
exposures_ms = [1, 2, 5]
[simulation]
paint = "some paint.json"
)";

/// What happened to the devices, in order.
struct Log {
  bool light_on = false, held = false;
  int lit = -1;
  double angle = 0;
  int n_captures = 0, n_dark = 0;
  std::function<void(RawFrame&)> disturb;  ///< before a frame is returned
};

class FakeTurntable final : public Turntable {
 public:
  explicit FakeTurntable(Log& log) : log_(log) {}
  void hold() noexcept override { log_.held = true; }
  std::string description() const override { return "fake turntable"; }

 private:
  double do_move_to(double angle) override { return log_.angle = angle + 1e-4; }  // reads back something else than asked
  Log& log_;
};

class FakeLights final : public LightSwitch {
 public:
  explicit FakeLights(Log& log) : log_(log) {}
  void off() noexcept override { log_.light_on = false; }
  std::string description() const override { return "fake lights"; }
  int n_lights() const override { return 2; }

 private:
  void do_on(int index) override {
    log_.light_on = true;
    log_.held = false;
    log_.lit = index;
  }
  Log& log_;
};

/// Each frame says in its first pixel which it is.
class FakeCamera final : public Camera {
 public:
  explicit FakeCamera(Log& log) : log_(log) {}
  std::string description() const override { return "fake camera"; }

 private:
  RawFrame do_capture(const CaptureSettings& asked) override {
    RawFrame frame{.width = 8, .height = 6, .layout = PixelLayout::bayer_grbg, .bits = 12, .data = {}, .actual = asked};
    frame.data.assign(48, static_cast<std::uint16_t>(100 + log_.lit));
    frame.data[0] = static_cast<std::uint16_t>(log_.n_captures++);
    log_.n_dark += !log_.light_on;
    frame.actual.exposure_s *= 1.01;
    frame.actual.gain_db = 0.5;
    if (log_.disturb) log_.disturb(frame);
    return frame;
  }
  Log& log_;
};

Rig fake_rig(Log& log) {
  Rig rig;
  rig.turntable = std::make_unique<FakeTurntable>(log);
  rig.lights = std::make_unique<FakeLights>(log);
  rig.camera = std::make_unique<FakeCamera>(log);
  return rig;
}

class SessionTest : public testing::Test {
 protected:
  Session capture(const Progress& progress = {}, const FrameSink& sink = {}, bool resume = false) {
    Rig rig = fake_rig(log);
    return capture_session(rig, parse_rig(rig_text, folder / "rig.toml"), session_folder, {"lacquer capture \"x\"", resume}, progress, sink);
  }
  std::string error_of(const std::function<void()>& action) {
    try {
      action();
    } catch (const Error& e) {
      std::string text = e.what();
      for (std::size_t at; (at = text.find(session_folder.string())) != std::string::npos;) text.replace(at, session_folder.string().size(), "S");
      EXPECT_EQ(text.find('\n'), std::string::npos);
      return text;
    }
    return "no error";
  }
  /// Error of reading the session after `from` became `to` in session.json.
  std::string error_with(const std::string& from, const std::string& to) {
    const auto file = session_folder / "session.json";
    const std::string text = brdf::read_text(file);
    std::string changed = text;
    const std::size_t at = changed.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    test::write_file(file, changed.replace(at, from.size(), to));
    const std::string error = error_of([&] { read_session(session_folder); });
    test::write_file(file, text);
    return error;
  }

  Log log;
  test::TemporaryFolder folder;
  const std::filesystem::path session_folder = folder / "session";
};

TEST_F(SessionTest, ComesBackAsItWasCaptured) {
  const Session written = capture();
  const Session s = read_session(session_folder);
  EXPECT_EQ(s.command_line, "lacquer capture \"x\"");
  EXPECT_EQ(s.software, std::string("lacquer ") + brdf::version());
  EXPECT_EQ(s.rig.name, "test");
  EXPECT_EQ(s.rig.simulation.paint, std::filesystem::absolute(folder / "some paint.json"));
  ASSERT_EQ(s.views.size(), 4u);
  EXPECT_EQ(s.views[3].id, "L003");
  EXPECT_EQ(s.views[3].light, 1);
  EXPECT_DOUBLE_EQ(s.views[3].turntable_angle, 10 * 3.14159265358979323846 / 180 + 1e-4) << "as read back";
  std::uint16_t n = 0;
  for (std::size_t v = 0; v < 4; ++v) {
    EXPECT_EQ(s.views[v].frames.size(), 3u);
    for (std::size_t e = 0; e < 3; ++e, ++n) {
      const FrameRecord& record = s.views[v].frames[e];
      EXPECT_EQ(record.file, written.views[v].frames[e].file);
      const RawFrame frame = read_session_frame(s, record);
      EXPECT_EQ(frame.data[0], n);
      EXPECT_EQ(frame.data[1], 100 + s.views[v].light);
      EXPECT_EQ(frame.layout, PixelLayout::bayer_grbg);
      EXPECT_DOUBLE_EQ(frame.actual.exposure_s, (std::vector{1e-3, 2e-3, 5e-3})[e] * 1.01) << "as read back";
      EXPECT_DOUBLE_EQ(frame.actual.gain_db, 0.5);
    }
  }
  EXPECT_EQ(s.views[2].frames[1].file, "frames/L002_E01.tiff");
  EXPECT_FALSE(log.light_on);
  EXPECT_TRUE(log.held);
}

TEST_F(SessionTest, SinkSeesEveryFrameAndViewInOrderWhenItIsOnDisk) {
  std::vector<std::string> seen;
  std::vector<std::size_t> steps;
  const auto stop_watch = [&](const std::string& stage, std::size_t done, std::size_t total) {
    EXPECT_EQ(stage, "capture");
    EXPECT_EQ(total, 12u);
    steps.push_back(done);
  };
  FrameSink sink;
  std::uint16_t n = 0;
  sink.frame = [&](const ViewRecord& view, const RawFrame& frame) {
    EXPECT_EQ(frame.data[0], n++);
    EXPECT_EQ(brdf::file_checksum(session_folder / view.frames.back().file), view.frames.back().checksum);
    seen.push_back(view.frames.back().file);
  };
  sink.view = [&](const ViewRecord& view) {
    EXPECT_EQ(view.frames.size(), 3u);
    seen.push_back(view.id);
  };
  capture(stop_watch, sink);
  std::vector<std::string> expected;
  for (std::size_t v = 0; v < 4; ++v) {
    for (std::size_t e = 0; e < 3; ++e) expected.push_back(frame_name("L00" + std::to_string(v), e));
    expected.push_back("L00" + std::to_string(v));
  }
  EXPECT_EQ(seen, expected);
  EXPECT_EQ(steps, (std::vector<std::size_t>{0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}));
  EXPECT_FALSE(std::filesystem::exists(session_folder / "capture.jsonl"));
  EXPECT_FALSE(std::filesystem::exists(session_folder / "capture.lock"));
}

TEST_F(SessionTest, LightsAreOffAndTheMotorHeldAfterEveryKindOfFailure) {
  const auto fails = [&](const std::function<void(RawFrame&)>& disturb, const Progress& progress, const FrameSink& sink) {
    log = Log{};
    log.disturb = disturb;
    Rig rig = fake_rig(log);
    EXPECT_THROW(capture_session(rig, parse_rig(rig_text, folder / "rig.toml"), session_folder, {}, progress, sink), std::exception);
    EXPECT_GT(log.n_captures, 0);
    EXPECT_FALSE(log.light_on);
    EXPECT_TRUE(log.held);
    EXPECT_FALSE(std::filesystem::exists(session_folder / "session.json"));
    EXPECT_EQ(error_of([&] { read_session(session_folder); }), "S: not a session, or its capture did not end: it has no session.json");
    std::filesystem::remove_all(session_folder);
  };
  fails([](RawFrame& f) { if (f.data[0] == 7) throw Error(ErrorCode::timeout, "no frame"); }, {}, {});
  fails([](RawFrame& f) { f.width = 6, f.height = 8; }, {}, {});
  fails([](RawFrame& f) { f.data[3] = 4096; }, {}, {});
  fails({}, [](const std::string&, std::size_t done, std::size_t) { if (done == 1) throw Error(ErrorCode::interrupted, "stop"); }, {});
  fails({}, {}, {.frame = {}, .view = [](const ViewRecord&) { throw std::runtime_error("sink"); }});
  fails({}, {}, {.frame = [](const ViewRecord&, const RawFrame&) { throw std::runtime_error("sink"); }, .view = {}});
}

TEST_F(SessionTest, FramesBeforeAnInterruptionStayOnDiskAndAreRecorded) {
  EXPECT_THROW(capture([](const std::string&, std::size_t done, std::size_t) {
    if (done == 4) throw Error(ErrorCode::interrupted, "stop");
  }), Error);
  for (const char* name : {"frames/L000_E00.tiff", "frames/L001_E00.tiff"})
    EXPECT_EQ(read_frame((session_folder / name).string(), 12, PixelLayout::bayer_grbg).width, 8);
  EXPECT_EQ(error_of([&] { capture(); }), "S: has a capture that did not end (4 frames); complete it with --resume or choose another folder");
}

TEST_F(SessionTest, DarkViewsAreTakenWithAllLightsOff) {
  std::string text = rig_text;
  text.replace(text.find("[simulation]"), 0, "dark_frames = 2\n");
  Rig rig = fake_rig(log);
  capture_session(rig, parse_rig(text, folder / "rig.toml"), session_folder, {}, {});
  EXPECT_EQ(log.n_captures, 12 + 2 * 3);
  EXPECT_EQ(log.n_dark, 2 * 3);
  const Session s = read_session(session_folder);
  ASSERT_EQ(s.views_of(ViewKind::dark), (std::vector<std::size_t>{4, 5}));
  EXPECT_EQ(s.views_of(ViewKind::measurement), (std::vector<std::size_t>{0, 1, 2, 3}));
  EXPECT_EQ(s.views[5].id, "D001");
  EXPECT_EQ(s.views[5].light, -1);
  EXPECT_EQ(s.views[5].frames[2].file, "frames/D001_E02.tiff");
  EXPECT_EQ(read_session_frame(s, s.views[5].frames[2]).data[0], 17) << "the last of 18 frames";
  EXPECT_EQ(error_with("\"light\": -1", "\"light\": 0"), "S/session.json: views[4].light: expected a number from -1 to -1");
  EXPECT_EQ(error_with("\"kind\": \"dark\"", "\"kind\": \"measurement\""),
            "S/session.json: views[4]: kind: \"measurement\"; the plan in rig.toml says \"dark\"");
}

TEST_F(SessionTest, FramesKnowWhenTheyWereTaken) {
  capture();
  const Session s = read_session(session_folder);
  double last = 0;
  for (const ViewRecord& view : s.views)
    for (const FrameRecord& frame : view.frames) {
      ASSERT_TRUE(frame.time_s);
      EXPECT_GE(*frame.time_s, last);
      last = *frame.time_s;
    }
  EXPECT_LT(last, 60) << "seconds since the capture began, not since the computer was started";
  ViewRecord view;
  EXPECT_FALSE(view.time_s()) << "no frames";
  view.frames.resize(2);
  view.frames[0].exposure_s = 0.5, view.frames[0].time_s = 10;
  view.frames[1].exposure_s = 2, view.frames[1].time_s = 11;
  EXPECT_DOUBLE_EQ(*view.time_s(), (10.25 + 12) / 2) << "the middle of the exposures";
  view.frames[1].time_s.reset();
  EXPECT_FALSE(view.time_s());
}

TEST_F(SessionTest, TimeGoesOnWhileNoProcessRuns) {
  EXPECT_EQ(elapsed_since(1000, 4600, 50), 3600);
  EXPECT_EQ(elapsed_since(1000, 400, 50), 50) << "the wall clock was set back: no frame before those that are there";
  EXPECT_THROW(capture([](const std::string&, std::size_t done, std::size_t) {
    if (done == 4) throw Error(ErrorCode::interrupted, "stop");
  }), Error);
  // As if the capture had begun an hour earlier.
  std::string journal = brdf::read_text(session_folder / "capture.jsonl");
  const std::string key = "\"begun_unix_s\":";
  const std::size_t at = journal.find(key) + key.size(), end = journal.find_first_of(",}", at);
  journal.replace(at, end - at, std::to_string(std::stod(journal.substr(at, end - at)) - 3600));
  test::write_file(session_folder / "capture.jsonl", journal);
  const Session s = capture({}, {}, true);
  EXPECT_LT(*s.views[0].frames[0].time_s, 60);
  EXPECT_GT(*s.views[3].frames[2].time_s, 3599);
  EXPECT_LT(*s.views[3].frames[2].time_s, 3660);
}

TEST_F(SessionTest, NothingIsOverwritten) {
  capture();
  const std::string before = brdf::read_text(session_folder / "session.json");
  EXPECT_EQ(error_of([&] { capture(); }), "S: has a session already (session.json); choose another folder or remove it");
  EXPECT_EQ(brdf::read_text(session_folder / "session.json"), before);
  std::filesystem::remove_all(session_folder);
  std::filesystem::create_directories(session_folder);
  EXPECT_NO_THROW(capture()) << "an empty folder may be there";
  std::filesystem::remove_all(session_folder);
  std::filesystem::create_directories(session_folder);
  test::write_file(session_folder / "thesis.txt", "do not touch");
  EXPECT_NE(error_of([&] { capture(); }).find("S: is not empty (thesis.txt) and no capture of Lacquer's"), std::string::npos);
  std::filesystem::remove_all(session_folder);
  test::write_file(session_folder, "a file");
  EXPECT_EQ(error_of([&] { capture(); }), "S: is a file; expected a folder for the session");
}

TEST_F(SessionTest, ErrorsOfSessionJsonNameTheField) {
  capture();
  EXPECT_EQ(error_with("\"version\": 1", "\"version\": 2"),
            "S/session.json: version: expected 1, got 2; the session was written by another version of Lacquer");
  EXPECT_EQ(error_with("\"version\": 1", "\"versiom\": 1"), "S/session.json: version: missing");
  for (const char* evil : {"../../etc/passwd", "/etc/passwd", "frames/../../x", "frames/sub/x.tiff", "frames/", "frames/.hidden", "x.tiff"})
    EXPECT_EQ(error_with("frames/L001_E02.tiff", evil),
              "S/session.json: views[1].frames[2].file: expected \"frames/NAME\" with letters, digits, _, - and . only");
  EXPECT_EQ(error_with("\"L001\"", "\"../x\""), "S/session.json: views[1].id: expected \"NAME\" with letters, digits, _, - and . only");
  EXPECT_EQ(error_with("\"L001\"", "\"L000\""), "S/session.json: views[1].id: \"L000\" is there twice");
  EXPECT_EQ(error_with("\"light\": 1", "\"light\": 2"), "S/session.json: views[1].light: expected a number from 0 to 1");
  EXPECT_EQ(error_with("\"exposure_s\": 0.00101", "\"exposure_s\": -1"),
            "S/session.json: views[0].frames[0].exposure_s: expected a number from 1e-09 to 1000000");
  EXPECT_EQ(error_with("\"exposure_s\": 0.00101", "\"exposure_s\": \"1\""),
            "S/session.json: views[0].frames[0].exposure_s: expected a number from 1e-09 to 1000000");
  EXPECT_EQ(error_with("\"rig.toml\": ", "\"../rig.toml\": "), "S/session.json: rig_files.../rig.toml: expected rig.toml or a file in rig/");
  EXPECT_NE(error_with("\"views\": [", "\"views\": {").find("S/session.json: not valid JSON: "), std::string::npos);
  const std::string whole = brdf::read_text(session_folder / "session.json");
  for (std::size_t n = 0; n + 2 < whole.size(); n += 101) {
    test::write_file(session_folder / "session.json", whole.substr(0, n));
    EXPECT_NE(error_of([&] { read_session(session_folder); }), "no error") << n;
  }
  EXPECT_EQ(error_of([&] { read_session(folder / "none"); }).find("no such folder") == std::string::npos, false);
}

TEST_F(SessionTest, ChangedOrMissingFilesAreErrors) {
  const Session s = capture();
  const auto file = session_folder / "frames/L000_E01.tiff";
  std::string bytes = brdf::read_text(file);
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 1);
  test::write_file(file, bytes);
  const FrameRecord& record = s.views[0].frames[1];
  EXPECT_NE(error_of([&] { read_session_frame(s, record); }).find("S/frames/L000_E01.tiff: checksum is "), std::string::npos);
  std::filesystem::remove(file);
  EXPECT_EQ(error_of([&] { read_session_frame(s, record); }), "S/frames/L000_E01.tiff: cannot be opened: No such file or directory");
  test::write_file(session_folder / "rig.toml", std::string(rig_text) + "\n");
  EXPECT_EQ(error_of([&] { read_session(session_folder); }),
            "S/rig.toml: was changed after the capture; session.json has another checksum");
}

}  // namespace
}  // namespace lacquer::acquire
