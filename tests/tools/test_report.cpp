#include <gtest/gtest.h>

#include <regex>
#include <set>

#include "libacquire/lens_residuals.h"
#include "libbrdf/files.h"
#include "test_support.h"

namespace lacquer {
namespace {

std::string sample(const std::string& name) { return (test::source_dir() / "data-samples" / name).string(); }

/// Everything between <TAG ...> and its end that `pattern` finds, first group.
std::vector<std::string> all_matches(const std::string& text, const std::string& pattern) {
  const std::regex regex(pattern);
  std::vector<std::string> list;
  for (std::sregex_iterator it(text.begin(), text.end(), regex), end; it != end; ++it) list.push_back((*it)[1]);
  return list;
}

/// What holds for every page: complete, alone, and usable without eyes.
void expect_good_page(const std::string& page) {
  EXPECT_LT(page.size(), 8u << 20);
  EXPECT_TRUE(page.starts_with("<!doctype html>"));
  EXPECT_TRUE(page.ends_with("</html>\n"));
  EXPECT_EQ(page.find("src=\"http"), std::string::npos);
  EXPECT_TRUE(all_matches(page, "(<(?:script|link)[^>]*(?:src|href)=\"(?!data:)[^\"]*\")").empty()) << "the page loads something";
  EXPECT_EQ(page.find("url(http"), std::string::npos);
  EXPECT_EQ(page.find("<img src"), std::string::npos) << "a picture without an alternative text";
  EXPECT_NE(page.find("class=skip"), std::string::npos);
  const auto ids = all_matches(page, " id=[\"']([^\"']+)[\"']");
  EXPECT_EQ(std::set<std::string>(ids.begin(), ids.end()).size(), ids.size()) << "an id stands for two things";
  for (const auto& target : all_matches(page, "href=[\"']#([^\"']+)[\"']")) EXPECT_NE(std::find(ids.begin(), ids.end(), target), ids.end()) << target;
}

TEST(Report, PageOfASessionHasEverySectionAndItsWarningsFirst) {
  const test::TemporaryFolder folder;
  const auto session = folder / "s";
  const auto measured = test::run_lacquer("measure " + sample("tiny-rig.toml") + " -o " + session.string());
  ASSERT_EQ(measured.exit_code, 0) << measured.err;
  const std::string page = brdf::read_text(session / "report.html");
  expect_good_page(page);
  for (const char* id : {"parameters", "comparison", "photographs", "spheres", "lobes", "slices", "capture", "sensor", "geometry", "provenance"})
    EXPECT_NE(page.find(std::string("<section id=\"") + id + "\""), std::string::npos) << id;
  const std::size_t warning = page.find("class=warning");
  ASSERT_NE(warning, std::string::npos);
  EXPECT_NE(page.find("taken from the rig file", warning), std::string::npos);
  EXPECT_LT(warning, page.find("<section"));
}

TEST(Report, ShowsWhatALensFileLeavesOfItsChessboards) {
  const test::TemporaryFolder folder;
  std::string rig = brdf::read_text(sample("tiny-rig.toml"));
  const std::string focal = "focal_length_px = 611 ", paint = "paints/";
  rig.replace(rig.find(focal), focal.size(), "lens_file = \"l.cameramodel\" ").replace(rig.find(paint), paint.size(), sample(paint));
  test::write_file(folder / "rig.toml", rig);
  acquire::Lens lens{"LENSMODEL_PINHOLE", 96, 72, {611, 611, 47.5, 35.5}, std::vector<double>(16, 0.0)};
  for (std::size_t i = 0; i < 4; ++i) lens.covariance[5 * i] = 0.01;
  // Distances 0.3, 0.4, 0.5 and 0: the mean square is 0.125.
  test::write_file(folder / "l.cameramodel", acquire::cameramodel_text(lens, "", "", {{{10, 10}, {0.3, 0}}, {{80, 10}, {0, -0.4}}, {{10, 60}, {0.3, 0.4}}, {{80, 60}, {0, 0}}}));
  const auto session = (folder / "s").string();
  for (const std::string command : {"capture " + (folder / "rig.toml").string() + " -o " + session, "merge " + session, "report " + session}) {
    const auto result = test::run_lacquer("-q " + command);
    ASSERT_EQ(result.exit_code, 0) << command << result.err;
  }
  const std::string page = brdf::read_text(folder / "s" / "report.html");
  expect_good_page(page);
  for (const char* text : {"LENSMODEL_PINHOLE, 4 corners that count, 0.354 px rms distance, 0.50 px at most", "Residuals of the chessboards", "Radial part of the corners", "Uncertainty of the lens over the image"})
    EXPECT_NE(page.find(text), std::string::npos) << text;
}

TEST(Report, PageOfBrdfFilesComparesThemWithTheFirst) {
  const test::TemporaryFolder folder;
  test::write_file(folder / "a.json", R"({"kd": [0.5, 0.5, 0.5], "lobes": []})");
  test::write_file(folder / "b<i>.json", R"({"kd": [0.25, 0.25, 0.25], "lobes": []})");
  const auto result = test::run_lacquer("report '" + (folder / "a.json").string() + "' '" + (folder / "b<i>.json").string() + "' -o " + (folder / "r.html").string());
  ASSERT_EQ(result.exit_code, 0) << result.err;
  const std::string page = brdf::read_text(folder / "r.html");
  expect_good_page(page);
  EXPECT_NE(page.find("0.69315"), std::string::npos) << "ln 2";
  EXPECT_EQ(page.find("b<i>"), std::string::npos) << "a file name becomes markup";
  EXPECT_NE(page.find("b&lt;i&gt;"), std::string::npos);
}

TEST(Report, WhatIsNotThereIsOneLine) {
  const auto result = test::run_lacquer("report /nowhere/at/all");
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("/nowhere/at/all"), std::string::npos);
  const test::TemporaryFolder folder;
  EXPECT_EQ(test::run_lacquer("report " + folder.path().string()).exit_code, 1) << "an empty folder is no session";
}

TEST(PlotCommand, EveryKindDrawsItsPicture) {
  const test::TemporaryFolder folder;
  const std::string a = sample("paints/blue.json"), b = sample("paints/white.json");
  for (const std::string call : {"log " + a + " " + b + " -o X.svg", "polar " + a + " -o X.svg", "slice " + a + " -o X.svg", "ratio " + a + " " + b + " -o X.svg",
                                 "delta-e " + a + " " + b + " --size 64 -o X.svg", "sphere " + a + " --size 64 -o X.png", "probe " + a + " --size 16 -o X.png"}) {
    std::string command = "plot " + call;
    const std::size_t at = command.find("X.");
    const std::string file = (folder / command.substr(at)).string();
    std::filesystem::remove(file);
    const auto result = test::run_lacquer(command.replace(at, std::string::npos, file));
    EXPECT_EQ(result.exit_code, 0) << call << ": " << result.err;
    EXPECT_GT(std::filesystem::file_size(file), 500u) << call;
  }
}

TEST(PlotCommand, UsageErrorsNameWhatIsWrong) {
  const std::string a = sample("paints/blue.json");
  EXPECT_EQ(test::run_lacquer("plot slice " + a + " " + a + " -o /tmp/x.svg").exit_code, 2);
  EXPECT_EQ(test::run_lacquer("plot sphere " + a + " -o /tmp/x.svg").exit_code, 2);
  EXPECT_EQ(test::run_lacquer("plot coverage " + a + " -o /tmp/x.svg").exit_code, 2);
  EXPECT_EQ(test::run_lacquer("plot nonsense " + a + " -o /tmp/x.svg").exit_code, 2);
}

}  // namespace
}  // namespace lacquer
