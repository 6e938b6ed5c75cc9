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

TEST(ConvertCommand, AModelWithGgxAndADielectricCoatGoesToTablesAndMaterialsButNotIntoAShaderThatKnowsNeither) {
  test::TemporaryFolder folder;
  test::write_file(folder / "g.json", R"({"kd": [0.05, 0.06, 0.07], "lobes": [
    {"ks": [0.1, 0.12, 0.14], "m": 0.25, "r": 0.6, "distribution": "ggx"},
    {"ks": [1, 1, 1], "m": 0.05, "r": 0.04, "distribution": "ggx", "fresnel": "dielectric"}]})");
  const std::string model = (folder / "g.json").string();
  const auto tensor = converted(model, folder / "g.bsdf");
  EXPECT_LT(tensor.at("relative_error").at("mean").get<double>(), 0.0025);
  EXPECT_LT(tensor.at("relative_error_near_specular").at("mean").get<double>(), 0.01);
  EXPECT_LT(converted(model, folder / "g.exr").at("metrics").at("mean_abs_log").get<double>(), 1e-6);
  for (const char* name : {"g.gltf", "g.mtlx"}) EXPECT_LT(converted(model, folder / name).at("metrics").at("mean_abs_log").get<double>(), 0.3) << name;
  const auto shader = test::run_lacquer("convert " + model + " -o " + (folder / "g.brdf").string());
  EXPECT_EQ(shader.exit_code, 1);
  EXPECT_NE(shader.err.find("convert to .bsdf"), std::string::npos) << shader.err;
  EXPECT_FALSE(std::filesystem::exists(folder / "g.brdf"));
}

TEST(ConvertCommand, AMeasuredFilmGoesThroughOurTableAndBackIntoATensorFile) {
  test::TemporaryFolder folder;
  const auto film = (test::source_dir() / "data-samples/measured/vch_golden_yellow_rgb.bsdf").string();
  // The file is not reciprocal by some 5 to 16 %, a table's cell holds both directions; the tensor file adds little to that.
  EXPECT_LT(converted(film, folder / "film.exr").at("metrics").at("cosine_rms").get<double>(), 0.06);
  EXPECT_LT(converted((folder / "film.exr").string(), folder / "again.bsdf").at("metrics").at("cosine_rms").get<double>(), 0.02);
  EXPECT_LT(converted(film, folder / "straight.bsdf").at("metrics").at("cosine_rms").get<double>(), 0.02);
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
