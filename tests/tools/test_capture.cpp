#include <gtest/gtest.h>

#include "libacquire/session.h"
#include "test_support.h"

namespace lacquer {
namespace {

/// A simulated rig that is done in a moment.
constexpr const char* small_rig = R"([rig]
name = "small"
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
angles_deg = [0, 30, 60]
exposures_ms = [1, 10]
[simulation]
paint = "paint.json"
)";

class CaptureTest : public testing::Test {
 protected:
  CaptureTest() {
    test::write_file(folder / "rig.toml", small_rig);
    test::write_file(folder / "paint.json", R"({"kd": [0.3, 0.2, 0.1], "lobes": []})");
    test::write_file(folder / "black.json", R"({"kd": [0, 0, 0], "lobes": []})");
  }
  test::CommandResult capture(const std::string& options) {
    return test::run_lacquer("capture " + (folder / "rig.toml").string() + " " + options + " -o " + (folder / "session").string());
  }
  std::uint16_t brightest() {
    const acquire::Session session = acquire::read_session(folder / "session");
    std::uint16_t best = 0;
    for (const auto& view : session.views)
      for (const auto& record : view.frames)
        for (const std::uint16_t v : acquire::read_session_frame(session, record).data) best = std::max(best, v);
    return best;
  }
  test::TemporaryFolder folder;
};

TEST_F(CaptureTest, WritesASessionThatReadsBack) {
  const auto result = capture("");
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.out.find("3 views, 6 frames"), std::string::npos) << result.out;
  const acquire::Session session = acquire::read_session(folder / "session");
  EXPECT_EQ(session.views.size(), 3u);
  EXPECT_NE(session.command_line.find("capture"), std::string::npos);
  EXPECT_GT(brightest(), 200) << "black level 64 and a lit sphere";
}

TEST_F(CaptureTest, PaintOfTheCommandLineReplacesThatOfTheRigFile) {
  ASSERT_EQ(capture("--paint " + (folder / "black.json").string()).exit_code, 0);
  EXPECT_LT(brightest(), 80) << "black level 64 and read noise only";
  EXPECT_EQ(acquire::read_session(folder / "session").rig.simulation.paint.filename(), "black.json");
}

TEST_F(CaptureTest, SecondCaptureIntoASessionIsRefused) {
  ASSERT_EQ(capture("-q").exit_code, 0);
  const auto again = capture("-q");
  EXPECT_EQ(again.exit_code, 1);
  EXPECT_NE(again.err.find("has a session already"), std::string::npos) << again.err;
  EXPECT_EQ(std::count(again.err.begin(), again.err.end(), '\n'), 1) << "one line";
}

TEST_F(CaptureTest, BadInputGivesOneLineAndTheRightExitCode) {
  test::write_file(folder / "rig.toml", std::string(small_rig) + "blurr_px = 1\n");
  const auto unknown = capture("");
  EXPECT_EQ(unknown.exit_code, 1);
  EXPECT_EQ(unknown.err, "lacquer: " + (folder / "rig.toml").string() + ": [simulation]: unknown key \"blurr_px\"; did you mean \"blur_px\"?\n");
  std::filesystem::remove(folder / "rig.toml");
  EXPECT_EQ(capture("").exit_code, 1);
  EXPECT_EQ(test::run_lacquer("capture").exit_code, 2);
}

}  // namespace
}  // namespace lacquer
