#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "libbrdf/files.h"
#include "tests/libbrdf/file_test_support.h"

namespace lacquer::brdf {
namespace {

using test::expect_file_error;

constexpr const char* good = R"({"kd": [0.1, 0.2, 0.3], "lobes": [{"ks": [1, 2, 3], "m": 0.5, "r": 0.25}]})";

/// The error of the text in which `from` was replaced by `to`.
void expect_error_with(const std::string& from, const std::string& to, const std::vector<std::string>& parts) {
  std::string text = good;
  text.replace(text.find(from), from.size(), to);
  expect_file_error([&] { model_from_json(text, "paint.json"); }, parts);
}

TEST(ModelJson, ReadsEveryNumber) {
  const CookTorrance model = model_from_json(good, "paint.json");
  EXPECT_EQ(model.kd, glm::dvec3(0.1, 0.2, 0.3));
  ASSERT_EQ(model.lobes.size(), 1u);
  EXPECT_EQ(model.lobes[0].ks, glm::dvec3(1, 2, 3));
  EXPECT_EQ(model.lobes[0].m, 0.5);
  EXPECT_EQ(model.lobes[0].r, 0.25);
}

TEST(ModelJson, SkipsWhateverElseAFitCarries) {
  const std::string fit = R"({"version": 1, "covariance": [[1, 2], [3, 4]], "candidates": [{"kd": "not ours", "lobes": 7}], )" +
                          std::string(good).substr(1, std::string(good).size() - 2) + R"(, "parameters": {"kd": null}})";
  EXPECT_EQ(model_from_json(fit, "fit.json").kd, glm::dvec3(0.1, 0.2, 0.3));
}

TEST(ModelJson, RoundTripsToTheLastBit) {
  CookTorrance model;
  model.kd = {1.0 / 3, 0.1, 5e-324};
  for (int i = 1; i <= 16; ++i) model.lobes.push_back({{std::sqrt(i), 1e-17 * i, std::exp(i / 2.0)}, 1.0 / i, std::nextafter(1.0 / i, 0)});
  const CookTorrance back = model_from_json(model_to_json(model), "back");
  EXPECT_EQ(back.kd, model.kd);
  ASSERT_EQ(back.lobes.size(), model.lobes.size());
  for (std::size_t i = 0; i < model.lobes.size(); ++i) {
    EXPECT_EQ(back.lobes[i].ks, model.lobes[i].ks);
    EXPECT_EQ(back.lobes[i].m, model.lobes[i].m);
    EXPECT_EQ(back.lobes[i].r, model.lobes[i].r);
  }
}

TEST(ModelJson, KeepsTheFormsOfALobeAndWritesOnlyTheUnusualOnes) {
  CookTorrance model;
  model.lobes = {{glm::dvec3(1), 0.2, 0.3}, {glm::dvec3(1), 0.1, 0.04, Distribution::ggx, Fresnel::dielectric}};
  const std::string text = model_to_json(model);
  EXPECT_EQ(text.find("beckmann"), std::string::npos) << text;
  const CookTorrance back = model_from_json(text, "back");
  EXPECT_EQ(back.lobes[0].distribution, Distribution::beckmann);
  EXPECT_EQ(back.lobes[0].fresnel, Fresnel::schlick);
  EXPECT_EQ(back.lobes[1].distribution, Distribution::ggx);
  EXPECT_EQ(back.lobes[1].fresnel, Fresnel::dielectric);
}

TEST(ModelJson, UnknownFormsAreNamed) {
  const auto complaint = [](const std::string& lobe) -> std::string {
    try {
      model_from_json(R"({"kd": [0, 0, 0], "lobes": [)" + lobe + "]}", "x");
    } catch (const Error& e) {
      return e.what();
    }
    return "";
  };
  EXPECT_NE(complaint(R"({"ks": [1, 1, 1], "m": 0.1, "r": 0.1, "distribution": "phong"})").find("lobes[0].distribution: expected \"beckmann\" or \"ggx\""), std::string::npos);
  EXPECT_NE(complaint(R"({"ks": [1, 1, 1], "m": 0.1, "r": 0.1, "fresnel": 3})").find("lobes[0].fresnel"), std::string::npos);
  EXPECT_NE(complaint(R"({"ks": [1, 1, 1], "m": 0.1, "r": 1.0, "fresnel": "dielectric"})").find("lobes[0].r: expected at most 0.99"), std::string::npos);
}

TEST(ModelJson, WritesThePaintEntryOfTable1) {
  const auto json = nlohmann::json::parse(model_to_json(model_from_json(good, "paint.json")));
  EXPECT_EQ(json, nlohmann::json::parse(good));
}

TEST(ModelJson, ReadsAModelWithoutLobesAndAByteOrderMark) {
  EXPECT_TRUE(model_from_json("\xef\xbb\xbf{\"kd\": [1, 1, 1], \"lobes\": []}", "x").lobes.empty());
}

TEST(ModelJson, NamesFileFieldAndWhatWasExpected) {
  expect_error_with("0.5", "1.7", {"paint.json: lobes[0].m: expected a number in (0, 1], got 1.7"});
  expect_error_with("0.5", "0", {"lobes[0].m: expected a number in (0, 1], got 0"});
  expect_error_with("0.5", "\"wide\"", {"lobes[0].m: expected a number in (0, 1], got string"});
  expect_error_with("0.5", "1e-200", {"lobes[0].m: expected at least 1e-06"});
  expect_error_with("0.25", "-0.1", {"lobes[0].r: expected a number in [0, 1], got -0.1"});
  expect_error_with("0.2,", "-0.2,", {"kd[1]: expected a number >= 0, got -0.2"});
  expect_error_with("0.2,", "1e300,", {"kd[1]: expected at most"});
  expect_error_with("0.2,", "null,", {"kd[1]: expected a number >= 0, got null"});
  expect_error_with("0.2, 0.3", "0.2", {"kd: expected 3 numbers [r, g, b], got 2"});
  expect_error_with("[1, 2, 3]", "4", {"lobes[0].ks: expected 3 numbers [r, g, b], got number"});
  expect_error_with("\"m\"", "\"mm\"", {"lobes[0].m: is missing"});
  expect_error_with("\"kd\"", "\"Kd\"", {"kd: is missing"});
  expect_error_with("\"lobes\"", "\"lobe\"", {"lobes: is missing"});
  expect_file_error([] { model_from_json(R"({"kd": [1, 1, 1], "lobes": {}})", "x"); }, {"lobes: expected an array", "object"});
  expect_error_with("{\"ks\": [1, 2, 3], \"m\": 0.5, \"r\": 0.25}", "3", {"lobes[0]: expected"});
}

TEST(ModelJson, SaysWhereTheTextIsNotJson) {
  expect_error_with("0.2,", "0.2,,", {"paint.json: is not valid JSON: parse error at line 1, column 18"});
  expect_error_with("0.2,", "1e999,", {"paint.json: is not valid JSON"});
  expect_error_with("0.2,", "NaN,", {"paint.json: is not valid JSON"});
  expect_file_error([] { model_from_json("", "paint.json"); }, {"paint.json: is not valid JSON"});
  expect_file_error([] { model_from_json("[1, 2]", "paint.json"); }, {"expected an object", "array"});
}

TEST(ModelJson, LimitsLobesNestingAndSize) {
  std::string lobes;
  for (int i = 0; i < 17; ++i) lobes += std::string(i ? "," : "") + R"({"ks": [1, 1, 1], "m": 1, "r": 1})";
  expect_file_error([&] { model_from_json("{\"kd\": [1, 1, 1], \"lobes\": [" + lobes + "]}", "x"); }, {"at most 16 lobes, got 17"});

  const std::string deep = std::string(10000000, '[');
  expect_file_error([&] { model_from_json(deep, "x"); }, {"nested deeper"});
  expect_file_error([&] { model_from_json("{\"kd\": " + deep, "x"); }, {"nested deeper"});
  expect_file_error([&] { model_from_json("{\"other\": " + deep, "x"); }, {"nested deeper"});
}

}  // namespace
}  // namespace lacquer::brdf
