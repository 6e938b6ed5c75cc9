#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/file.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <random>
#include <set>
#include <thread>

#include "libacquire/open_rig.h"
#include "libacquire/session.h"
#include "libbrdf/brdf.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "test_support.h"

/// Whatever ends a capture, resuming it gives the bytes of one that ran through (simulated rig).
namespace lacquer::acquire {
namespace {

namespace fs = std::filesystem;

constexpr const char* rig_text = R"(
[rig]
name = "resume"
kind = "simulated"
[camera]
width_px = 24
height_px = 18
layout = "rggb"
bits = 12
focal_length_px = 150
position_mm = [0, 0, 1000]
[sensor]
black_level_dn = 64
gain_e_per_dn = 4.2
read_noise_e = 5
sensitivity_e_per_s = [4.0e5, 5.0e5, 4.2e5]
[[lights]]
position_mm = [0, 124.747, 586.889]
intensity = [0.55, 0.58, 0.48]
[[lights]]
position_mm = [50, 300, 500]
intensity = [0.55, 0.58, 0.48]
[plan]
angles_deg = { from = 0, to = 30, step = 10 }
exposures_ms = { from = 0.5, to = 128, count = 3 }
reference_every = 2
dark_frames = 2
[simulation]
paint = "paint.json"
readback_noise_rms_deg = 0.01
led_drift_per_hour = 0.1
led_noise_rms = 0.01
)";

/// Two lights at four angles, the first two views again after every second one, darkness twice: 18 views of 3 frames, in this order.
const std::vector<std::string> view_ids{"L000", "L001", "R000", "R001", "L002", "L003", "R002", "R003", "L004",
                                        "L005", "R004", "R005", "L006", "L007", "R006", "R007", "D000", "D001"};
constexpr std::size_t n_exposures = 3, n_frames = 54;

/// All files of a folder by name, their bytes as checksums.
std::map<std::string, std::string> content(const fs::path& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder))
    if (entry.is_regular_file()) files[fs::relative(entry.path(), folder).string()] = brdf::file_checksum(entry.path());
  return files;
}

/// Names of files that differ or are in one only; empty: the same.
std::string difference(const std::map<std::string, std::string>& a, const std::map<std::string, std::string>& b) {
  std::string names;
  for (const auto& [name, checksum] : a)
    if (const auto other = b.find(name); other == b.end() || other->second != checksum) names += name + " ";
  for (const auto& [name, checksum] : b)
    if (!a.contains(name)) names += name + " ";
  return names;
}

class ResumeTest : public testing::Test {
 protected:
  Session run(const fs::path& into, bool resume, const Progress& progress = {}, const FrameSink& sink = {}, const std::string& text = rig_text) {
    const RigDescription description = parse_rig(text, folder / "rig.toml");
    Rig rig = open_rig(description, brdf::load_brdf(test::source_dir() / "data-samples/paints/white.json"));
    const SensorNoise noise{.black_level_dn = 64, .saturation_dn = 4095, .gain_e_per_dn = 4.2, .read_noise_e = 5};
    return capture_session(rig, description, into, {.command_line = "lacquer capture", .resume = resume, .noise = noise}, progress, sink);
  }
  /// A capture that ends after `n` frames.
  void interrupt_after(std::size_t n) {
    EXPECT_THROW(run(session, false, [&](const std::string&, std::size_t done, std::size_t) {
      if (done == n) throw Error(ErrorCode::interrupted, "stop");
    }), Error);
  }
  ResumeTest() {
    run(folder / "undisturbed", false);
    expected = content(folder / "undisturbed");
  }
  /// Completes the session; the sink must see every frame in order.
  void expect_completed(const std::string& what) {
    std::vector<std::string> seen;
    FrameSink sink;
    sink.frame = [&](const ViewRecord& view, const RawFrame& frame) {
      EXPECT_EQ(frame.width, 24);
      seen.push_back(view.frames.back().file);
    };
    run(session, true, {}, sink);
    EXPECT_EQ(difference(content(session), expected), "") << what;
    ASSERT_EQ(seen.size(), n_frames) << what;
    for (std::size_t i = 0; i < n_frames; ++i) EXPECT_EQ(seen[i], frame_name(view_ids[i / n_exposures], i % n_exposures)) << what;
    fs::remove_all(session);
  }
  std::string error_of(const std::function<void()>& action) {
    try {
      action();
    } catch (const Error& e) {
      return e.what();
    }
    return "no error";
  }

  test::TemporaryFolder folder;
  const fs::path session = folder / "session";
  std::map<std::string, std::string> expected;
};

TEST_F(ResumeTest, AnUndisturbedSessionHoldsItsFramesRigAndRecordOnly) { EXPECT_EQ(expected.size(), n_frames + 2); }

TEST_F(ResumeTest, InterruptedAfterAnyFrame) {
  for (std::size_t n = 0; n <= n_frames; n += 3) {
    interrupt_after(n);
    expect_completed("interrupted after frame " + std::to_string(n));
  }
}

TEST_F(ResumeTest, InterruptedAgainAndAgain) {
  interrupt_after(5);
  for (const std::size_t n : {5u, 6u, 20u, 53u})
    EXPECT_THROW(run(session, true, [&](const std::string&, std::size_t done, std::size_t) {
      if (done == n) throw Error(ErrorCode::interrupted, "stop");
    }), Error);
  expect_completed("five times");
}

// The frames that choose a bracket are not recorded before it is chosen; once it is, it stays.
TEST_F(ResumeTest, AdaptiveBracketsStopped) {
  std::string text = rig_text;
  text.replace(text.find("[plan]\n"), 7, "[plan]\nadaptive = true\n");
  text.replace(text.find("count = 3"), 9, "count = 6");
  int n_calls = 0;
  fs::remove_all(folder / "undisturbed");
  const Session whole = run(folder / "undisturbed", false, [&](const std::string&, std::size_t, std::size_t) { ++n_calls; }, {}, text);
  expected = content(folder / "undisturbed");
  std::set<std::size_t> sizes;
  for (const ViewRecord& view : whole.views) sizes.insert(view.frames.size());
  EXPECT_GT(sizes.size(), 1u) << "views are to have different brackets";
  for (int stop = 1; stop <= n_calls; stop += 5) {
    int n = 0;
    EXPECT_THROW(run(session, false, [&](const std::string&, std::size_t, std::size_t) {
      if (++n == stop) throw Error(ErrorCode::interrupted, "stop");
    }, {}, text), Error);
    if (stop % 2 == 0) fs::remove(session / frame_name("L000", 4));
    run(session, true, {}, {}, text);
    EXPECT_EQ(difference(content(session), expected), "") << "stopped at call " << stop << " of " << n_calls;
    fs::remove_all(session);
  }
}

TEST_F(ResumeTest, FramesThatAreDamagedOrGoneAreTakenAgain) {
  const auto damage = [&](const std::string& what, const std::function<void()>& work) {
    interrupt_after(30);
    work();
    expect_completed(what);
  };
  damage("frame gone", [&] { fs::remove(session / frame_name("R000", 1)); });
  damage("frame cut short", [&] { fs::resize_file(session / frame_name("L000", 0), 100); });
  damage("bit flipped", [&] {
    std::fstream file(session / frame_name("R001", 2), std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(400);
    file.put('\x55');
  });
  damage("frame written but not recorded", [&] { test::write_file(session / frame_name("L005", 0), "half a file"); });
  damage("temporary file left", [&] { test::write_file(session / "frames/.L004_E00.123-4.tmp.tiff", "half a file"); });
  damage("journal cut in a line", [&] { fs::resize_file(session / "capture.jsonl", fs::file_size(session / "capture.jsonl") - 20); });
  damage("journal cut in its first line", [&] { fs::resize_file(session / "capture.jsonl", 20); });
  damage("journal empty", [&] { fs::resize_file(session / "capture.jsonl", 0); });
  damage("journal gone", [&] { fs::remove(session / "capture.jsonl"); });
  damage("lock left by a dead process", [&] { test::write_file(session / "capture.lock", ""); });
}

TEST_F(ResumeTest, OfACompleteSessionReadsItOnly) {
  run(session, false);
  expect_completed("complete");
}

TEST_F(ResumeTest, WithAnotherRigFileIsRefusedAndNothingIsTouched) {
  interrupt_after(10);
  const auto before = content(session);
  std::string other = rig_text;
  other.replace(other.find("count = 3"), 9, "count = 4");
  EXPECT_NE(error_of([&] { run(session, true, {}, {}, other); }).find("rig.toml: the rig file (or a file it names) is not the one this capture began with"),
            std::string::npos);
  EXPECT_EQ(difference(content(session), before), "");
}

TEST_F(ResumeTest, AJournalThatIsNoneIsAnErrorWithItsLine) {
  interrupt_after(10);
  const std::string journal = brdf::read_text(session / "capture.jsonl");
  const std::size_t second = journal.find('\n') + 1;
  for (const char* line : {"garbage\n", "{\"view\": -1, \"turntable_angle_rad\": 0}\n", "{\"view\": 0}\n", "[]\n",
                           R"({"view":0,"exposure":0,"file":"../../etc/passwd","exposure_s":1,"gain_db":0,"checksum":"0","source":""})" "\n"}) {
    test::write_file(session / "capture.jsonl", journal.substr(0, second) + line);
    EXPECT_NE(error_of([&] { run(session, true); }).find("capture.jsonl:2: "), std::string::npos) << line;
  }
}

TEST_F(ResumeTest, ASecondCaptureIntoTheSameFolderIsRefusedWhileOneRuns) {
  interrupt_after(3);
  const int held = ::open((session / "capture.lock").c_str(), O_RDWR | O_CREAT, 0644);
  ASSERT_EQ(flock(held, LOCK_EX), 0);
  EXPECT_NE(error_of([&] { run(session, true); }).find("another capture is writing into this folder"), std::string::npos);
  ::close(held);
  expect_completed("after the other let go");
}

/// Runs the executable in a process of its own; `prepare` in the child before.
pid_t start(const std::vector<std::string>& arguments, const std::function<void()>& prepare = {}) {
  std::vector<char*> argv;
  std::vector<std::string> all{LACQUER_BINARY};
  all.insert(all.end(), arguments.begin(), arguments.end());
  for (std::string& argument : all) argv.push_back(argument.data());
  argv.push_back(nullptr);
  const pid_t child = fork();
  if (child != 0) return child;
  if (prepare) prepare();
  const int nowhere = ::open("/dev/null", O_WRONLY);
  dup2(nowhere, STDOUT_FILENO);
  dup2(nowhere, STDERR_FILENO);
  execv(argv[0], argv.data());
  _exit(127);
}

int wait_for(pid_t child) {
  int status = 0;
  waitpid(child, &status, 0);
  return status;
}

/// The executable's sessions: their command line says --resume from the start, so that it is the same in all of them.
class ResumeProcessTest : public ResumeTest {
 protected:
  ResumeProcessTest() {
    test::write_file(folder / "rig.toml", rig_text);
    fs::copy_file(test::source_dir() / "data-samples/paints/white.json", folder / "paint.json");
    arguments = {"-q", "capture", (folder / "rig.toml").string(), "--resume", "-o", session.string()};
    const auto begin = std::chrono::steady_clock::now();
    EXPECT_EQ(wait_for(start(arguments)), 0);
    whole_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
    expected = content(session);
    fs::remove_all(session);
  }
  void expect_completed_by_process(const std::string& what) {
    EXPECT_EQ(wait_for(start(arguments)), 0) << what;
    EXPECT_EQ(difference(content(session), expected), "") << what;
    fs::remove_all(session);
  }
  std::vector<std::string> arguments;
  double whole_s = 0;
};

#if defined(__SANITIZE_ADDRESS__)
constexpr int n_kills = 25;  // a sanitized process takes ten times as long to start
#else
constexpr int n_kills = 200;
#endif

// A process that dies of SIGKILL has no chance to put anything in order. Random moments between its start and a little after its end.
TEST_F(ResumeProcessTest, KilledAtTwoHundredRandomMoments) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> moment(0, 1.1 * whole_s);
  int killed = 0;
  for (int i = 0; i < n_kills; ++i) {
    const double seconds = moment(random);
    const pid_t child = start(arguments);
    std::this_thread::sleep_for(std::chrono::duration<double>(seconds));
    kill(child, SIGKILL);
    killed += WIFSIGNALED(wait_for(child));
    expect_completed_by_process("killed after " + std::to_string(seconds) + " s of " + std::to_string(whole_s));
  }
  EXPECT_GT(killed, n_kills / 4) << "many were to be killed before their end";
}

/// Waits until a session's journal holds that many lines; false: the process ended before.
bool wait_for_lines(const fs::path& journal, std::ptrdiff_t n, pid_t child) {
  for (;;) {
    std::ifstream file(journal);
    if (std::count(std::istreambuf_iterator<char>(file), {}, '\n') >= n) return true;
    siginfo_t info{};
    if (waitid(P_PID, static_cast<id_t>(child), &info, WEXITED | WNOHANG | WNOWAIT) == 0 && info.si_pid == child) return false;
    std::this_thread::sleep_for(std::chrono::microseconds(200));
  }
}

// The signal comes when a part of the frames is recorded, however slow the machine. The process is stopped meanwhile: reading the journal
// must not take longer than the rest of the capture.
TEST_F(ResumeProcessTest, CtrlCEndsWithExitCode130AndCanBeResumed) {
  // Pictures that take longer than writing them: tiny ones are all taken before the first are on disk, and then nothing is left to interrupt.
  std::string text = rig_text;
  for (const auto& [from, to] : std::map<std::string, std::string>{{"width_px = 24", "width_px = 144"}, {"height_px = 18", "height_px = 108"}, {"focal_length_px = 150", "focal_length_px = 900"}})
    text.replace(text.find(from), from.size(), to);
  test::write_file(folder / "rig.toml", text);
  ASSERT_EQ(wait_for(start(arguments)), 0);
  expected = content(session);
  fs::remove_all(session);
  int interrupted = 0;
  for (int i = 1; i <= 6; ++i) {
    const pid_t child = start(arguments);
    if (wait_for_lines(session / "capture.jsonl", 3 * i, child)) {
      kill(child, SIGSTOP);
      kill(child, i % 2 ? SIGINT : SIGTERM);
      kill(child, SIGCONT);
    }
    const int status = wait_for(child);
    // Whoever comes after the last frame finds that it ends well.
    EXPECT_TRUE(WIFEXITED(status) && (WEXITSTATUS(status) == 130 || WEXITSTATUS(status) == 0)) << status;
    interrupted += WIFEXITED(status) && WEXITSTATUS(status) == 130;
    expect_completed_by_process("signal " + std::to_string(i));
  }
  EXPECT_GT(interrupted, 0);
}

// A limit on the size of files stands for a full disk: writing fails in the middle of a frame, of the journal, of session.json.
TEST_F(ResumeProcessTest, AFullDiskEndsWithOneLineAndCanBeResumed) {
  for (const rlim_t bytes : {0u, 100u, 600u, 1100u, 5000u, 9000u}) {
    const int status = wait_for(start(arguments, [&] {
      const rlimit limit{bytes, bytes};
      setrlimit(RLIMIT_FSIZE, &limit);
      signal(SIGXFSZ, SIG_IGN);
    }));
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 1) << bytes << " " << status;
    expect_completed_by_process("files of at most " + std::to_string(bytes) + " bytes");
  }
}

}  // namespace
}  // namespace lacquer::acquire
