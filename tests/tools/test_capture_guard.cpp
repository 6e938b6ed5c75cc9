#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <map>
#include <thread>

#include "libbrdf/files.h"
#include "test_support.h"

/// What somebody at a terminal sees when a capture begins badly or ends early.
namespace lacquer {
namespace {

namespace fs = std::filesystem;

constexpr const char* rig_text = R"([rig]
name = "guarded"
kind = "simulated"
[camera]
width_px = 48
height_px = 36
layout = "rggb"
bits = 12
focal_length_px = 305
position_mm = [0, 0, 1000]
[sensor]
black_level_dn = 64
gain_e_per_dn = 4
sensitivity_e_per_s = 5e5
[[lights]]
position_mm = [0, 125, 587]
[plan]
angles_deg = { from = 0, to = 20, step = 1 }
exposures_ms = [1, 10]
[simulation]
paint = "paint.json"
)";

std::map<std::string, std::string> frames_of(const fs::path& session) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::directory_iterator(session / "frames")) files[entry.path().filename()] = brdf::file_checksum(entry.path());
  return files;
}

class CaptureGuardTest : public testing::Test {
 protected:
  CaptureGuardTest() {
    fs::create_directories(folder / "a folder");
    test::write_file(rig, rig_text);
    test::write_file(folder / "a folder/paint.json", R"({"kd": [0.3, 0.2, 0.1], "lobes": []})");
  }
  /// stderr of a capture that gets `signal` once a few frames are on disk, and its exit code. On a busy machine the signal can come after
  /// the last frame: then once more.
  test::CommandResult interrupted_by(int signal, const std::vector<std::string>& arguments) {
    for (int i = 0; i < 20; ++i) {
      const auto result = signalled(signal, arguments);
      if (result.exit_code != 0) return result;
      fs::remove_all(session);
    }
    return {0, "", ""};
  }
  test::CommandResult signalled(int signal, const std::vector<std::string>& arguments) {
    const fs::path err = folder / "err";
    const pid_t child = fork();
    if (child == 0) {
      std::vector<std::string> all{LACQUER_BINARY};
      all.insert(all.end(), arguments.begin(), arguments.end());
      std::vector<char*> argv;
      for (std::string& a : all) argv.push_back(a.data());
      argv.push_back(nullptr);
      if (!freopen(err.c_str(), "w", stderr) || !freopen("/dev/null", "w", stdout)) _exit(126);
      execv(argv[0], argv.data());
      _exit(127);
    }
    for (int i = 0; i < 5000 && !fs::exists(session / "frames/L003_E00.tiff"); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    kill(child, signal);
    int status = 0;
    waitpid(child, &status, 0);
    return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, "", brdf::read_text(err)};
  }
  test::TemporaryFolder folder;
  const fs::path rig = folder / "a folder/rig.toml", session = folder / "a folder/it's a session";
};

// The line is taken at its word: run by a shell, it completes the session.
TEST_F(CaptureGuardTest, CtrlCEndsWithTheCommandThatGoesOnAndItWorks) {
  ASSERT_EQ(test::run_lacquer("-q capture '" + rig.string() + "' --no-checks -o " + (folder / "other").string()).exit_code, 0);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) {
    const auto result = interrupted_by(signal, {"-q", "capture", rig.string(), "-o", session.string()});
    EXPECT_EQ(result.exit_code, 130) << result.err;
    const std::string expected = "lacquer: interrupted while capture; what was written so far is kept\n"
                                 "lacquer: lights off, motor held; resume with: lacquer -q capture '" + rig.string() + "' -o '" +
                                 (folder / "a folder/it").string() + "'\\''s a session' --resume\n";
    EXPECT_EQ(result.err, expected);
    EXPECT_FALSE(fs::exists(session / "session.json"));
    ASSERT_NE(result.err.find("resume with: lacquer "), std::string::npos);
    const std::size_t at = result.err.find("resume with: lacquer ") + 21;
    const auto resumed = test::run_lacquer(result.err.substr(at, result.err.find('\n', at) - at));
    EXPECT_EQ(resumed.exit_code, 0) << resumed.err;
    EXPECT_EQ(frames_of(session), frames_of(folder / "other")) << "and its frames are those of a run without interruption, or checks";
    fs::remove_all(session);
  }
}

TEST_F(CaptureGuardTest, MeasureEndsWithItsOwnCommand) {
  const auto result = interrupted_by(SIGINT, {"-q", "measure", rig.string(), "-o", session.string(), "--resume"});
  EXPECT_EQ(result.exit_code, 130);
  EXPECT_NE(result.err.find("lacquer: lights off, motor held; resume with: lacquer -q measure "), std::string::npos) << result.err;
  EXPECT_EQ(result.err.find("--resume"), result.err.rfind("--resume")) << "once is enough";
}

TEST_F(CaptureGuardTest, AFullDiskEndsWithTheCommandToo) {
  const std::string limited = "trap '' XFSZ; ulimit -f 3; " + std::string(LACQUER_BINARY) + " -q capture '" + rig.string() + "' -o " +
                              (folder / "limited").string() + " 2>" + (folder / "err").string();
  EXPECT_EQ(WEXITSTATUS(std::system(("bash -c \"" + limited + "\"").c_str())), 1);
  const std::string err = brdf::read_text(folder / "err");
  EXPECT_NE(err.find("lacquer: lights off, motor held; resume with: lacquer -q capture "), std::string::npos) << err;
}

TEST_F(CaptureGuardTest, NothingToResumeNothingSaid) {
  ASSERT_EQ(test::run_lacquer("-q capture '" + rig.string() + "' -o " + (folder / "s").string()).exit_code, 0);
  const auto again = test::run_lacquer("-q capture '" + rig.string() + "' -o " + (folder / "s").string());
  EXPECT_EQ(again.exit_code, 1);
  EXPECT_EQ(again.err.find("resume"), std::string::npos) << again.err;
}

// The simulated sensor gets a black level that its rig file does not state: a rig is photographed with another's file.
TEST_F(CaptureGuardTest, ChecksOfARigThatPrintAndFailAsTheyFind) {
  const auto good = test::run_lacquer("-q capture --check '" + rig.string() + "'");
  EXPECT_EQ(good.exit_code, 0) << good.err;
  for (const char* line : {"camera: simulated camera", "good    camera: linear in exposure: signals 1 : ", "good    camera: black level: ", "good    light \"light 0\": visible: "})
    EXPECT_NE(good.out.find(line), std::string::npos) << line << " in\n" << good.out;

  std::string curved = rig_text;
  curved.replace(curved.find("[[lights]]"), 0, "response = \"gamma\"\ngamma = 2.2\n");
  test::write_file(rig, curved);
  EXPECT_EQ(test::run_lacquer("-q capture --check '" + rig.string() + "'").exit_code, 0) << "the rig file says so";
  test::write_file(folder / "a folder/paint.json", R"({"kd": [0, 0, 0], "lobes": []})");
  const auto black = test::run_lacquer("-q capture --check '" + rig.string() + "'");
  EXPECT_EQ(black.exit_code, 1);
  EXPECT_NE(black.out.find("FAILED  light \"light 0\": visible: "), std::string::npos) << black.out;
  EXPECT_NE(black.err.find("rig.toml: 1 of "), std::string::npos) << black.err;
}

}  // namespace
}  // namespace lacquer
