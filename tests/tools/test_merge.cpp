#include <cmath>

#include "libacquire/frame.h"
#include "libbrdf/error.h"
#include "libcalib/calibration.h"
#include "libcalib/frame_list.h"
#include "test_support.h"

namespace lacquer {
namespace {

using acquire::PixelLayout;
using acquire::RawFrame;
using test::run_lacquer;

/// A ramp of radiance, 12 bit, linear, free of noise, as TIFF files; returns the list's lines.
std::string write_ramp(const test::TemporaryFolder& folder, PixelLayout layout) {
  std::string list = "file,exposure_s\n";
  int i = 0;
  for (const double t : {0.01, 0.04, 0.16}) {
    RawFrame f{64, 16, layout, 12, {}, {t, 0}};
    for (int k = 0; k < 64 * 16 * acquire::values_per_pixel(layout); ++k)
      f.data.push_back(static_cast<std::uint16_t>(std::min(std::lround(1000.0 * (1 + k % 64) * t), 4095L)));
    const std::string name = "frame" + std::to_string(i++) + ".tiff";
    acquire::write_frame((folder / name).string(), f);
    list += name + "," + std::to_string(t) + "\n";
  }
  return list;
}

std::string merge_arguments(const test::TemporaryFolder& folder, const std::string& more) {
  return "merge --frames " + (folder / "list.csv").string() + " -o " + (folder / "out.exr").string() + " " + more;
}

TEST(MergeCommand, MergesLooseLinearFramesToTheKnownRadiance) {
  const test::TemporaryFolder folder;
  test::write_file(folder / "list.csv", write_ramp(folder, PixelLayout::mono));
  const auto result = run_lacquer(merge_arguments(folder, "--bits 12 --response linear --gain 10 --read-noise 3"));
  ASSERT_EQ(result.exit_code, 0) << result.err;
  EXPECT_NE(result.out.find("64 x 16 mono"), std::string::npos) << result.out;
  const auto image = calib::read_radiance(folder / "out.exr");
  // Rounding is the only error: at most half a DN at 0.01 s, 50 DN/s.
  for (std::size_t i = 0; i < image.radiance.size(); ++i)
    EXPECT_NEAR(image.radiance[i], 1000.0 * static_cast<double>(1 + i % 64), 50) << i;
}

TEST(MergeCommand, EstimatesSavesAndReusesAResponse) {
  const test::TemporaryFolder folder;
  test::write_file(folder / "list.csv", write_ramp(folder, PixelLayout::bayer_rggb));
  const std::string response = (folder / "response.json").string();
  const auto estimated = run_lacquer(merge_arguments(folder, "--bits 12 --layout rggb --save-response " + response));
  ASSERT_EQ(estimated.exit_code, 0) << estimated.err;
  EXPECT_NE(estimated.out.find("response: estimated"), std::string::npos) << estimated.out;
  EXPECT_EQ(calib::read_radiance(folder / "out.exr").layout, PixelLayout::bayer_rggb);
  const auto reused = run_lacquer(merge_arguments(folder, "--bits 12 --layout rggb --response " + response));
  ASSERT_EQ(reused.exit_code, 0) << reused.err;
  EXPECT_EQ(reused.out.find("response: estimated"), std::string::npos) << reused.out;
}

TEST(MergeCommand, AListWithByteOrderMarkCrlfFractionsAndQuotesIsRead) {
  const test::TemporaryFolder folder;
  test::write_file(folder / "list.csv", "\xEF\xBB\xBF" "file,exposure_s\r\na.png, 1/1024\r\n\r\n\"b, \"\"c\"\".png\",2.5e-1\r\n/x/d.png,32");
  const auto frames = calib::read_frame_list(folder / "list.csv");
  ASSERT_EQ(frames.size(), 3u);
  EXPECT_EQ(frames[0].file, folder / "a.png");
  EXPECT_DOUBLE_EQ(frames[0].exposure_s, 1.0 / 1024);
  EXPECT_EQ(frames[1].file, folder / "b, \"c\".png");
  EXPECT_EQ(frames[1].line, 4);
  EXPECT_DOUBLE_EQ(frames[1].exposure_s, 0.25);
  EXPECT_EQ(frames[2].file, "/x/d.png");
}

TEST(MergeCommand, EachFaultOfAListIsNamedWithItsLine) {
  const test::TemporaryFolder folder;
  const struct {
    const char *text, *message;
  } cases[] = {
      {"", "list.csv:1: header: expected \"file,exposure_s\", the file is empty"},
      {"file;exposure_s\n", "list.csv:1: header: expected \"file,exposure_s\", got \"file;exposure_s\""},
      {"file,exposure_s\n", "list.csv:1: expected at least one frame below the header, got none"},
      {"file,exposure_s\na.png,1\nb.png,x\n", "list.csv:3: exposure_s: expected a positive number, got \"x\""},
      {"file,exposure_s\na.png,-1\n", "list.csv:2: exposure_s: expected a positive number, got \"-1\""},
      {"file,exposure_s\na.png,nan\n", "list.csv:2: exposure_s: expected a positive number, got \"nan\""},
      {"file,exposure_s\na.png,1/0\n", "list.csv:2: exposure_s: expected a positive number, got \"1/0\""},
      {"file,exposure_s\na.png,\n", "list.csv:2: exposure_s: expected a positive number, got \"\""},
      {"file,exposure_s\na.png\n", "list.csv:2: expected 2 columns, file,exposure_s, got 1"},
      {"file,exposure_s\na.png,1,2\n", "list.csv:2: expected 2 columns"},
      {"file,exposure_s\n,1\n", "list.csv:2: file: expected a file name, got nothing"},
      {"file,exposure_s\n\"a.png,1\n", "list.csv:2: file: expected a closing quote"},
      {"file,exposure_s\na.png,1e9\n", "list.csv:2: exposure_s: expected a number of seconds in [1e-9, 1e6], got \"1e9\""},
  };
  for (const auto& c : cases) {
    test::write_file(folder / "list.csv", c.text);
    try {
      calib::read_frame_list(folder / "list.csv");
      ADD_FAILURE() << c.text;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::input);
      EXPECT_NE(std::string(e.what()).find(c.message), std::string::npos) << e.what();
    }
  }
}

TEST(MergeCommand, AFrameOfAnotherSizeIsNamedWithListLineAndFile) {
  const test::TemporaryFolder folder;
  std::string list = write_ramp(folder, PixelLayout::mono);
  acquire::write_frame((folder / "small.tiff").string(), {8, 8, PixelLayout::mono, 12, std::vector<std::uint16_t>(64, 5), {1, 0}});
  test::write_file(folder / "list.csv", list + "small.tiff,1\n");
  const auto result = run_lacquer(merge_arguments(folder, "--bits 12"));
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("list.csv:5: file: "), std::string::npos) << result.err;
  EXPECT_NE(result.err.find("small.tiff is 8 x 8 mono, expected 64 x 16 mono"), std::string::npos) << result.err;
  EXPECT_FALSE(std::filesystem::exists(folder / "out.exr"));
}

TEST(MergeCommand, EqualTimesCannotGiveAResponseAndSaySo) {
  const test::TemporaryFolder folder;
  write_ramp(folder, PixelLayout::mono);
  test::write_file(folder / "list.csv", "file,exposure_s\nframe0.tiff,1\nframe1.tiff,1\n");
  const auto result = run_lacquer(merge_arguments(folder, "--bits 12"));
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("expected frames with different exposure times"), std::string::npos) << result.err;
}

/// The quick simulated rig with three views and a response to be estimated.
void write_short_rig(const std::filesystem::path& file) {
  std::ifstream in(test::source_dir() / "rigs/simulated-quick.toml");
  std::string text(std::istreambuf_iterator<char>(in), {});
  const auto replace = [&](const std::string& from, const std::string& to) {
    const std::size_t at = text.find(from);
    ASSERT_NE(at, std::string::npos) << from;
    text.replace(at, from.size(), to);
  };
  replace("step = 3", "step = 90");
  replace("../data-samples", (test::source_dir() / "data-samples").string());
  replace("[sensor]\n", "[sensor]\nresponse = \"estimate\"\n");
  test::write_file(file, text);
}

// The simulated sensor is linear: an estimated curve may differ from v - 64 by its statistical error, 0.3 % of 4 brackets.
TEST(MergeCommand, MergesASessionAndStoresTheResponseItEstimated) {
  const test::TemporaryFolder folder;
  write_short_rig(folder / "rig.toml");
  const std::string session = (folder / "session").string();
  const auto capture = run_lacquer("-q capture " + (folder / "rig.toml").string() + " -o " + session);
  ASSERT_EQ(capture.exit_code, 0) << capture.err;
  const auto merged = run_lacquer("-q merge " + session);
  ASSERT_EQ(merged.exit_code, 0) << merged.err;
  EXPECT_NE(merged.out.find("3 views merged, response: estimated"), std::string::npos) << merged.out;
  const auto calibration = calib::read_calibration(folder / "session/calibration.json");
  ASSERT_EQ(calibration.response.curves.size(), 3u);
  for (const auto& curve : calibration.response.curves)
    for (std::size_t v = 200; v < 4000; v += 100) EXPECT_NEAR(curve.exposure[v] / (static_cast<double>(v) - 64), 1, 0.01) << v;
  EXPECT_NEAR(calibration.noise.gain_e_per_dn, 4.2, 0.3);
  std::size_t n = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder / "session/radiance")) {
    EXPECT_EQ(calib::read_radiance(entry.path()).layout, PixelLayout::bayer_rggb);
    ++n;
  }
  EXPECT_EQ(n, 3u);
}

TEST(MergeCommand, WrongUsageExitsWithTwoAndFailuresWithOne) {
  const test::TemporaryFolder folder;
  EXPECT_EQ(run_lacquer("merge").exit_code, 2);
  EXPECT_EQ(run_lacquer("merge --frames nowhere.csv").exit_code, 2) << "no output named";
  EXPECT_EQ(run_lacquer("merge --frames nowhere.csv -o x.exr --bits 20").exit_code, 2);
  EXPECT_EQ(run_lacquer(merge_arguments(folder, "")).exit_code, 1) << "no such list";
  EXPECT_EQ(run_lacquer("merge " + (folder / "no-session").string()).exit_code, 1);
}

}  // namespace
}  // namespace lacquer
