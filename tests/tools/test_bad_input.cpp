#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>

#include "libbrdf/files.h"
#include "libbrdf/table.h"
#include "test_support.h"

/// Bad input of every kind through the executable: exit code 1 and ONE line on stderr that names the file.
namespace lacquer {
namespace {

using test::run_lacquer;

std::string quoted(const std::filesystem::path& p) { return "'" + p.string() + "'"; }

class BadInput : public testing::Test {
 protected:
  void expect_one_line(const std::string& arguments, const std::string& named, const std::string& said = "") {
    const auto result = run_lacquer("-q " + arguments);
    EXPECT_EQ(result.exit_code, 1) << arguments << "\n" << result.err;
    EXPECT_EQ(std::count(result.err.begin(), result.err.end(), '\n'), 1) << result.err;
    EXPECT_NE(result.err.find(named), std::string::npos) << result.err;
    EXPECT_NE(result.err.find(said), std::string::npos) << result.err;
    EXPECT_EQ(result.out, "");
  }
  void truncate(const std::filesystem::path& file, double share) {
    std::filesystem::resize_file(file, static_cast<std::uintmax_t>(share * static_cast<double>(std::filesystem::file_size(file))));
  }
  std::filesystem::path copy_of_session() {
    const auto session = folder / "session";
    std::filesystem::copy(test::source_dir() / "data-samples" / "session-tiny", session, std::filesystem::copy_options::recursive);
    return session;
  }
  std::filesystem::path sample(const std::string& name) { return test::source_dir() / "data-samples" / name; }
  test::TemporaryFolder folder;
};

TEST_F(BadInput, MissingFiles) {
  const auto nothing = folder / "nothing";
  expect_one_line("compare " + quoted(nothing) + " " + quoted(nothing), "nothing");
  expect_one_line("fit " + quoted(nothing) + " -o " + quoted(folder / "fit.json"), "nothing");
  expect_one_line("measure " + quoted(nothing) + " -o " + quoted(folder / "s"), "nothing");
  expect_one_line("merge " + quoted(nothing), "nothing");
  expect_one_line("tabulate " + quoted(nothing), "nothing");
  expect_one_line("rerender " + quoted(nothing), "nothing");
  expect_one_line("merge --frames " + quoted(nothing) + " -o " + quoted(folder / "o.exr"), "nothing");
}

TEST_F(BadInput, MissingAndTruncatedFrames) {
  const auto session = copy_of_session();
  truncate(session / "frames" / "L003_E01.tiff", 0.5);
  expect_one_line("merge " + quoted(session), "L003_E01.tiff");
  std::filesystem::remove(session / "frames" / "L003_E01.tiff");
  expect_one_line("merge " + quoted(session), "L003_E01.tiff");
}

TEST_F(BadInput, FrameOfTheWrongSize) {
  test::write_file(folder / "a.pgm", "P5\n4 2\n255\n12345678");
  test::write_file(folder / "b.pgm", "P5\n2 2\n255\n1234");
  test::write_file(folder / "list.csv", "file,exposure_s\na.pgm,0.1\nb.pgm,0.2\n");
  expect_one_line("merge --frames " + quoted(folder / "list.csv") + " -o " + quoted(folder / "o.exr"), "b.pgm");
  EXPECT_FALSE(std::filesystem::exists(folder / "o.exr"));
}

TEST_F(BadInput, TruncatedBsdf) {
  std::filesystem::copy(sample("measured/vch_golden_yellow_rgb.bsdf"), folder / "film.bsdf");
  truncate(folder / "film.bsdf", 0.7);
  expect_one_line("compare " + quoted(folder / "film.bsdf") + " " + quoted(sample("paints/blue.json")), "film.bsdf");
}

TEST_F(BadInput, TruncatedAndForeignMerl) {
  brdf::HalfAngleTable table(3);
  brdf::write_merl(folder / "m.binary", table);
  truncate(folder / "m.binary", 0.999);
  expect_one_line("compare " + quoted(folder / "m.binary") + " " + quoted(sample("paints/blue.json")), "m.binary");
  test::write_file(folder / "noise.binary", std::string(1000, '\x5a'));
  expect_one_line("compare " + quoted(folder / "noise.binary") + " " + quoted(sample("paints/blue.json")), "noise.binary");
}

TEST_F(BadInput, TruncatedTable) {
  brdf::HalfAngleTable table(1);
  brdf::write_table(folder / "t.exr", table);
  truncate(folder / "t.exr", 0.6);
  expect_one_line("fit " + quoted(folder / "t.exr") + " -o " + quoted(folder / "fit.json"), "t.exr");
  EXPECT_FALSE(std::filesystem::exists(folder / "fit.json"));
}

TEST_F(BadInput, BrokenJson) {
  test::write_file(folder / "p.json", R"({"kd": [0.1, 0.2], "lobes": []})");
  expect_one_line("compare " + quoted(folder / "p.json") + " " + quoted(sample("paints/blue.json")), "p.json", "kd");
  test::write_file(folder / "p.json", R"({"kd": [0.1, 0.2,)");
  expect_one_line("compare " + quoted(folder / "p.json") + " " + quoted(sample("paints/blue.json")), "p.json");
  const auto session = copy_of_session();
  truncate(session / "session.json", 0.5);
  expect_one_line("tabulate " + quoted(session), "session.json");
}

TEST_F(BadInput, UnknownKeyInATomlNamesTheNearestKnownOne) {
  std::string text = brdf::read_text(sample("tiny-rig.toml"));
  text.replace(text.find("read_noise_e"), 12, "readnoise_e");
  test::write_file(folder / "rig.toml", text);
  expect_one_line("measure " + quoted(folder / "rig.toml") + " -o " + quoted(folder / "s"), "rig.toml", "did you mean \"read_noise_e\"");
  EXPECT_FALSE(std::filesystem::exists(folder / "s"));
}

TEST_F(BadInput, BrokenToml) {
  test::write_file(folder / "rig.toml", "[rig\nname = ");
  expect_one_line("measure " + quoted(folder / "rig.toml") + " -o " + quoted(folder / "s"), "rig.toml");
  std::string text = brdf::read_text(sample("tiny-rig.toml"));
  text.replace(text.find("[0, 124.747, 586.889]"), 21, "[0, 124.747]");
  test::write_file(folder / "rig.toml", text);
  expect_one_line("measure " + quoted(folder / "rig.toml") + " -o " + quoted(folder / "s"), "lights[0].position_mm", "expected 3 numbers, got 2");
}

TEST_F(BadInput, UsageErrorsExitWithTwo) {
  EXPECT_EQ(run_lacquer("").exit_code, 2);
  EXPECT_EQ(run_lacquer("paint").exit_code, 2);
  EXPECT_EQ(run_lacquer("fit").exit_code, 2);
  EXPECT_EQ(run_lacquer("measure x --lobes 99 -o y").exit_code, 2);
  EXPECT_EQ(run_lacquer("--help").exit_code, 0);
  EXPECT_EQ(run_lacquer("--version").exit_code, 0);
}

}  // namespace
}  // namespace lacquer
