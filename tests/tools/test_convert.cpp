#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "test_support.h"

namespace lacquer {
namespace {

std::string paint() { return (test::source_dir() / "data-samples/paints/polaris-silber.json").string(); }

nlohmann::json converted(const std::string& input, const std::filesystem::path& output, const std::string& more = "") {
  const auto result = test::run_lacquer("convert " + input + " -o " + output.string() + " --json " + more);
  EXPECT_EQ(result.exit_code, 0) << result.err;
  return nlohmann::json::parse(result.out, nullptr, false);
}

TEST(ConvertCommand, ATableGoesThroughForeignTablesWithoutLossOfValues) {
  test::TemporaryFolder folder;
  // The model at the cells' centres, from here on only copied.
  const auto first = converted(paint(), folder / "a.exr");
  EXPECT_LT(first.at("metrics").at("mean_abs_log").get<double>(), 1e-6);
  std::filesystem::path last = folder / "a.exr";
  for (const char* name : {"b.npy", "c.binary"}) {
    const auto j = converted(last.string(), folder / name);
    EXPECT_LT(j.at("relative_error").at("max").get<double>(), 1e-6) << name;  // MERL's scales: a float times and divided by a factor
    EXPECT_EQ(j.at("relative_error").at("n_lost"), 0) << name;
    EXPECT_EQ(j.at("metrics").at("delta_e_2000_mean").get<double>(), 0.0) << name;
    last = folder / name;
  }
}

TEST(ConvertCommand, SaysTheLossOfATensorFileToPeople) {
  test::TemporaryFolder folder;
  const auto result = test::run_lacquer("convert " + paint() + " -o " + (folder / "p.bsdf").string());
  ASSERT_EQ(result.exit_code, 0) << result.err;
  for (const char* part : {"RGL .bsdf, RGB", "file as read back", "within 75 deg", "relative error", "near mirror direction", "dE2000"})
    EXPECT_NE(result.out.find(part), std::string::npos) << part << "\n" << result.out;
  const auto spectral = converted(paint(), folder / "s.bsdf", "--format bsdf-spectral --theta-i 8 --resolution 16");
  EXPECT_EQ(spectral.at("format"), "RGL .bsdf, spectral");
}

TEST(ConvertCommand, RenderersMaterialsComeFromAModelAndStateTheirLoss) {
  test::TemporaryFolder folder;
  for (const char* name : {"p.scn", "p.gltf", "p.mtlx", "p.brdf", "p.mbsdf"}) {
    const auto j = converted(paint(), folder / name);
    EXPECT_GT(std::filesystem::file_size(folder / name), 300u) << name;
    EXPECT_LT(j.at("metrics").at("mean_abs_log").get<double>(), 0.2) << name;
    EXPECT_EQ(j.at("metrics").at("mean_abs_log").get<double>() < 1e-9, std::string(name) == "p.brdf") << name;
  }
  const auto film = (test::source_dir() / "data-samples/measured/vch_golden_yellow_rgb.bsdf").string();
  const auto result = test::run_lacquer("convert " + film + " -o " + (folder / "f.gltf").string());
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("fit the table first"), std::string::npos) << result.err;
}

TEST(ConvertCommand, WrongUseIsExitCode2AndLeavesTheInputAlone) {
  test::TemporaryFolder folder;
  const std::string copy = (folder / "p.bsdf").string();
  std::filesystem::copy(paint(), copy);
  EXPECT_EQ(test::run_lacquer("convert " + copy + " -o " + copy).exit_code, 2);
  EXPECT_TRUE(std::filesystem::file_size(copy) == std::filesystem::file_size(paint()));
  const auto unknown = test::run_lacquer("convert " + paint() + " -o " + (folder / "p.xyz").string());
  EXPECT_EQ(unknown.exit_code, 2);
  EXPECT_NE(unknown.err.find(".bsdf"), std::string::npos) << unknown.err;
  EXPECT_EQ(test::run_lacquer("convert " + paint() + " -o x.exr --format jpeg").exit_code, 2);
  EXPECT_EQ(test::run_lacquer("convert " + paint() + " -o " + (folder / "r.bsdf").string() + " --resolution 3").exit_code, 2);
}

}  // namespace
}  // namespace lacquer
