#include <fmt/format.h>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>

#include "libacquire/open_rig.h"
#include "libacquire/session.h"
#include "libbrdf/error.h"
#include "test_support.h"

namespace lacquer::acquire {
namespace {

/// Two views of two exposures each, the longer one first, as cameras with descending brackets name them; value = 1000 view + exposure.
class ReplayTest : public testing::Test {
 protected:
  ReplayTest() {
    std::filesystem::create_directories(photos());
    for (int i = 0; i < 4; ++i) {
      cv::Mat image(48, 64, CV_16UC3, cv::Scalar(3, 2, 1000 * (i / 2) + (i % 2 ? 100 : 400)));  // blue, green, red
      cv::imwrite((photos() / fmt::format("p{}.png", 7 + i)).string(), image);
    }
    cv::Mat mask(48, 64, CV_8UC1, cv::Scalar(0));
    for (int y = 0; y < 48; ++y)
      for (int x = 0; x < 64; ++x) mask.at<unsigned char>(y, x) = (x - 30) * (x - 30) + (y - 20) * (y - 20) < 225 ? 255 : 0;
    cv::imwrite((photos() / "mask.png").string(), mask);
    test::write_file(photos() / "directions.txt", "# x right, y up, z to the camera\n0 0 2\n\n0 0.6\t0.8\r\n");
    test::write_file(photos() / "intensities.txt", "1 2 3\n4\n");
    test::write_file(folder / "rig.toml", text);
  }
  std::filesystem::path photos() const { return folder / "photos"; }

  std::string error_of(const std::string& from, const std::string& to) {
    std::string changed = text;
    const std::size_t at = changed.find(from);
    EXPECT_NE(at, std::string::npos);
    try {
      open_rig(parse_rig(changed.replace(at, from.size(), to), folder / "rig.toml"), nullptr);
    } catch (const Error& e) {
      return std::string(e.what()).substr((folder / "rig.toml").string().size() + 2);
    }
    return "no error";
  }

  const std::string text = R"([rig]
name = "photographs"
kind = "replay"
[camera]
width_px = 64
height_px = 48
layout = "rgb"
bits = 12
projection = "orthographic"
[mask]
file = "mask.png"
[replay]
folder = "photos"
file_pattern = "p%d.png"
first = 7
last = 10
frames_per_view = 2
exposures_s = [0.4, 0.1]
light_directions_file = "directions.txt"
light_intensities_file = "intensities.txt"
[scale]
absolute = false
)";
  test::TemporaryFolder folder;
};

TEST_F(ReplayTest, SessionHoldsThePhotographsInOrderOfExposure) {
  const RigDescription description = read_rig(folder / "rig.toml");
  Rig rig = open_rig(description, nullptr);
  capture_session(rig, description, folder / "session", {}, {});
  std::filesystem::remove_all(photos());  // a session needs nothing but itself
  std::filesystem::rename(folder / "session", folder / "moved");

  const Session s = read_session(folder / "moved");
  EXPECT_FALSE(s.rig.absolute_scale);
  EXPECT_EQ(s.rig.geometry.lights.at(0).direction, glm::dvec3(0, 0, 1));
  EXPECT_EQ(s.rig.geometry.lights.at(0).intensity, glm::dvec3(1, 2, 3));
  EXPECT_EQ(s.rig.geometry.lights.at(1).intensity, glm::dvec3(4));
  EXPECT_NEAR(s.rig.geometry.cam_from_rig.translation.x * s.rig.geometry.camera.focal.x + s.rig.geometry.camera.centre.x, 30, 1e-9);
  EXPECT_TRUE(s.rig.mask.file && std::filesystem::exists(*s.rig.mask.file));
  ASSERT_EQ(s.views.size(), 2u);
  for (int v = 0; v < 2; ++v) {
    EXPECT_EQ(s.views[v].light, v);
    ASSERT_EQ(s.views[v].frames.size(), 2u);
    for (int e = 0; e < 2; ++e) {
      const FrameRecord& record = s.views[v].frames[e];
      const RawFrame frame = read_session_frame(s, record);
      EXPECT_DOUBLE_EQ(frame.actual.exposure_s, e ? 0.4 : 0.1);
      EXPECT_EQ(frame.data[0], 1000 * v + (e ? 400 : 100)) << "red";
      EXPECT_EQ(frame.data[1], 2) << "green";
      EXPECT_EQ(frame.data[2], 3) << "blue";
      EXPECT_EQ(std::filesystem::path(record.source).filename(), fmt::format("p{}.png", 7 + 2 * v + (e ? 0 : 1)));
    }
  }
}

TEST_F(ReplayTest, DataFolderTakesThePlaceOfTheOneInTheRigFile) {
  std::filesystem::rename(photos(), folder / "other");
  EXPECT_THROW(read_rig(folder / "rig.toml"), Error);
  EXPECT_EQ(read_rig(folder / "rig.toml", folder / "other").plan.at(1).files.at(1), folder / "other/p9.png");
}

TEST_F(ReplayTest, CameraStopsAfterTheLastPhotographAndKeepsTheOrder) {
  const RigDescription description = read_rig(folder / "rig.toml");
  Rig rig = open_rig(description, nullptr);
  EXPECT_THROW(rig.camera->capture({.exposure_s = 0.3, .gain_db = 0}), Error);
  for (int i = 0; i < 4; ++i) EXPECT_NO_THROW(rig.camera->capture({.exposure_s = i % 2 ? 0.4 : 0.1, .gain_db = 0}));
  EXPECT_THROW(rig.camera->capture({.exposure_s = 0.1, .gain_db = 0}), Error);
}

TEST_F(ReplayTest, WrongSetsOfPhotographsAreErrors) {
  EXPECT_EQ(error_of("last = 10", "last = 11"), "replay.frames_per_view: 5 files cannot be divided into views of 2");
  EXPECT_EQ(error_of("last = 10", "last = 12"),
            "replay.files: 3 views with 2 lights; expected one light per view, or plan.lights to say which");
  EXPECT_EQ(error_of("last = 10", "last = 12\n[plan]\nlights = [0, 1, 1]\n[replay_]").substr(0, 12), "unknown key ");
  EXPECT_EQ(error_of("p%d.png", "p%s.png"), "replay.file_pattern: expected one number such as %03d in it, got \"p%s.png\"");
  EXPECT_EQ(error_of("p%d.png", "p%d%n.png"), "replay.file_pattern: expected one number such as %03d in it, got \"p%d%n.png\"");
  EXPECT_EQ(error_of("p%d.png", "p%03d.png"),
            "replay: no photograph " + (photos() / "p008.png").string() + " (for photographs elsewhere: --data FOLDER)");
  EXPECT_EQ(error_of("[0.4, 0.1]", "[0.4, 0.1, 3]"),
            "replay.exposures_s: expected 1 number, 2 (one per frame of a view) or 4 (one per file), got 3");
  test::write_file(photos() / "intensities.txt", "1 2 3\n");
  EXPECT_NE(error_of("last", "last").find("has 1 lights; expected 2 as in"), std::string::npos);
  test::write_file(photos() / "intensities.txt", "1 2 3\n1 2\n");
  EXPECT_THROW(read_rig(folder / "rig.toml"), Error);
  test::write_file(photos() / "intensities.txt", "1 2 3\n1 2 nan\n");
  EXPECT_THROW(read_rig(folder / "rig.toml"), Error);
}

TEST_F(ReplayTest, PhotographOfAnotherFormatIsNamed) {
  const auto error = [&] {
    const RigDescription description = read_rig(folder / "rig.toml");
    Rig rig = open_rig(description, nullptr);
    try {
      rig.camera->capture({.exposure_s = 0.1, .gain_db = 0});
    } catch (const Error& e) {
      return std::string(e.what()).substr((photos() / "p8.png").string().size());
    }
    return std::string("no error");
  };
  EXPECT_EQ(error(), "no error");
  cv::imwrite((photos() / "p8.png").string(), cv::Mat(48, 63, CV_16UC3, cv::Scalar(0)));
  EXPECT_EQ(error(), ": 63 x 48 pixels; expected 64 x 48 as in the rig file");
  cv::imwrite((photos() / "p8.png").string(), cv::Mat(48, 64, CV_16UC1, cv::Scalar(0)));
  EXPECT_EQ(error(), ": pixel layout mono; expected rgb as in the rig file");
  cv::imwrite((photos() / "p8.png").string(), cv::Mat(48, 64, CV_16UC3, cv::Scalar(0, 4096, 0)));
  EXPECT_EQ(error(), ": pixel (0, 0) has value 4096; expected 12 bits, at most 4095; are the bits right?");
}

}  // namespace
}  // namespace lacquer::acquire
