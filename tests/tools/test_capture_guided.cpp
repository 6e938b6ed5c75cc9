#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <map>

#include "libacquire/session.h"
#include "libbrdf/files.h"
#include "test_support.h"

/// Captures with a person in them: a line of stdin stands for one who pressed Enter.
namespace lacquer {
namespace {

namespace fs = std::filesystem;

constexpr const char* rig_text = R"([rig]
name = "guided"
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
[[lights]]
position_mm = [0, 400, 400]
[plan]
angles_deg = [60, 10, 30]
exposures_ms = [1, 4, 10]
dark_frames = 2
[simulation]
paint = "paint.json"
)";

class GuidedTest : public testing::Test {
 protected:
  GuidedTest() {
    test::write_file(folder / "rig.toml", rig_text);
    test::write_file(folder / "paint.json", R"({"kd": [0.3, 0.2, 0.1], "lobes": []})");
  }
  /// `n_lines` of stdin.
  test::CommandResult capture(const std::string& options, int n_lines, const std::string& session = "session") {
    test::write_file(folder / "lines", std::string(static_cast<std::size_t>(n_lines), '\n'));
    return test::run_lacquer("capture " + (folder / "rig.toml").string() + " " + options + " -o " + (folder / session).string() + " < " +
                             (folder / "lines").string());
  }
  std::map<std::string, std::string> frames(const std::string& session) {
    std::map<std::string, std::string> files;
    for (const auto& entry : fs::directory_iterator(folder / session / "frames")) files[entry.path().filename()] = brdf::file_checksum(entry.path());
    return files;
  }
  test::TemporaryFolder folder;
};

TEST_F(GuidedTest, BoardsAreOneFramePerLineAndNothingElseIsInTheirFolder) {
  const auto result = capture("--boards 3", 3);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.err.find("board 3 of 3: hold the chessboard still in another place and at another tilt; then press Enter\n"), std::string::npos) << result.err;
  EXPECT_NE(result.err.find("frames/L002_E00.tiff: 4 ms, 99 % of the values up to "), std::string::npos) << result.err;
  EXPECT_NE(result.out.find("boards: " + (folder / "session/frames/*.tiff").string()), std::string::npos) << result.out;
  EXPECT_EQ(frames("session").size(), 3u);
  const acquire::Session session = acquire::read_session(folder / "session");
  ASSERT_EQ(session.views.size(), 3u);
  for (const auto& view : session.views) {
    EXPECT_EQ(view.light, 0);
    ASSERT_EQ(view.frames.size(), 1u);
    EXPECT_EQ(view.frames[0].exposure_s, 0.004) << "the middle one of the plan";
    EXPECT_EQ(acquire::read_session_frame(session, view.frames[0]).width, 48);
  }
  EXPECT_NE(frames("session")["L000_E00.tiff"], frames("session")["L001_E00.tiff"]) << "each is a photograph of its own";
}

TEST_F(GuidedTest, BoardsGoOnWhereStdinEnded) {
  const auto ended = capture("--boards 4 --exposure-ms 2.5", 2);
  EXPECT_EQ(ended.exit_code, 1);
  EXPECT_NE(ended.err.find("lacquer: standard input ended while waiting for board 3 of 4; expected a line for each\n"
                           "lacquer: lights off, motor held; resume with: lacquer capture "), std::string::npos) << ended.err;
  EXPECT_EQ(frames("session").size(), 2u);
  EXPECT_EQ(capture("--boards 5 --exposure-ms 2.5 --resume", 5).exit_code, 1) << "another plan";
  const auto resumed = capture("--boards 4 --exposure-ms 2.5 --resume", 2);
  ASSERT_EQ(resumed.exit_code, 0) << resumed.err;
  EXPECT_EQ(resumed.err.find("board 2 of 4"), std::string::npos) << "it is there already: " << resumed.err;
  ASSERT_EQ(capture("--boards 4 --exposure-ms 2.5", 4, "undisturbed").exit_code, 0);
  EXPECT_EQ(frames("session"), frames("undisturbed"));
}

TEST_F(GuidedTest, WhiteReferenceIsEveryLightOnceWhereItIsNearestToTheCamera) {
  const auto result = capture("--white-reference", 1);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.err.find("white reference: put it where the sphere stands; then press Enter\n"), std::string::npos) << result.err;
  const acquire::Session session = acquire::read_session(folder / "session");
  ASSERT_EQ(session.views.size(), 4u);
  for (std::size_t v = 0; v < 4; ++v) {
    EXPECT_EQ(session.views[v].light, v < 2 ? static_cast<int>(v) : -1);
    EXPECT_EQ(session.views[v].frames.size(), 3u) << "whole brackets";
    if (v < 2) {
      EXPECT_NEAR(session.views[v].turntable_angle, 10 / 57.29577951308232, 1e-9);
    }
  }
  const auto merged = test::run_lacquer("-q merge " + (folder / "session").string());
  EXPECT_EQ(merged.exit_code, 0) << merged.err;
  EXPECT_TRUE(fs::exists(folder / "session/radiance/L001.exr"));
}

TEST_F(GuidedTest, TimerStandsInForEnter) {
  const auto result = capture("--boards 2 --every-s 0.1", 0);
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.err.find("and at another tilt (in 0.1 s)\n"), std::string::npos) << result.err;
  EXPECT_EQ(frames("session").size(), 2u);
}

TEST_F(GuidedTest, CtrlCWhileWaitingEndsAtOnce) {
  int never[2];
  ASSERT_EQ(pipe(never), 0);
  const fs::path err = folder / "err";
  const std::string rig = folder / "rig.toml", session = folder / "session";
  const pid_t child = fork();
  if (child == 0) {
    dup2(never[0], STDIN_FILENO);
    if (!freopen(err.c_str(), "w", stderr)) _exit(126);
    execl(LACQUER_BINARY, LACQUER_BINARY, "capture", rig.c_str(), "--boards", "3", "-o", session.c_str(), nullptr);
    _exit(127);
  }
  const auto said = [&](const char* text) { return fs::exists(err) && brdf::read_text(err).find(text) != std::string::npos; };
  for (int i = 0; i < 3000 && !said("press Enter"); ++i) usleep(10000);
  kill(child, SIGINT);
  int status = 0;
  waitpid(child, &status, 0);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 130) << status;
  EXPECT_TRUE(said("lacquer: interrupted while waiting for board 1 of 3; what was written so far is kept\nlacquer: lights off, motor held; resume with: "))
      << brdf::read_text(err);
  close(never[0]);
  close(never[1]);
}

TEST_F(GuidedTest, MistakesAreNamed) {
  EXPECT_EQ(capture("--boards 3 --white-reference", 3).exit_code, 2);
  EXPECT_EQ(capture("--white-reference --exposure-ms 3", 3).exit_code, 2);
  EXPECT_EQ(capture("--boards 3 --dry-run", 3).exit_code, 2);
  EXPECT_EQ(capture("--boards 0", 3).exit_code, 2);
  test::write_file(folder / "rig.toml", std::string(rig_text) + "[guided]\nboards = 2\nwhite_reference = true\n");
  const auto both = capture("", 0);
  EXPECT_EQ(both.exit_code, 1);
  EXPECT_NE(both.err.find("guided.boards: expected either this or white_reference = true"), std::string::npos) << both.err;
  test::write_file(folder / "rig.toml", std::string(rig_text) + "[guided]\nboards = 2\n");
  EXPECT_NE(capture("--boards 3", 3).err.find("[guided]: this is the rig file of a guided capture"), std::string::npos);
}

}  // namespace
}  // namespace lacquer
