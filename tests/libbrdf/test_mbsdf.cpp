#include "libbrdf/mbsdf.h"

#include <cmath>
#include <numbers>

#include "libbrdf/files.h"
#include "libbrdf/relative_error.h"
#include "tests/libbrdf/file_test_support.h"
#include "tests/libbrdf/table1_paints.h"

namespace lacquer::brdf {
namespace {

using test::expect_file_error;
using test::TemporaryFolder;

constexpr double pi = std::numbers::pi;

std::string mbsdf(std::uint32_t type, std::uint32_t n_theta, std::uint32_t n_phi, const std::vector<float>& values, const std::string& key = "MBSDF_DATA=\n") {
  std::string s = "NVIDIA ARC MBSDF V1\ndescription=\"by hand\"\n" + key + test::raw(type) + test::raw(n_theta) + test::raw(n_phi);
  for (const float v : values) s += test::raw(v);
  return s;
}

TEST(Mbsdf, IndexIsThetaInThenThetaOutThenPhiAtCellCentres) {
  TemporaryFolder folder;
  std::vector<float> values;
  for (int i = 0; i < 2; ++i)
    for (int o = 0; o < 2; ++o)
      for (int p = 0; p < 3; ++p)
        for (int c = 0; c < 3; ++c) values.push_back(static_cast<float>(1000 * i + 100 * o + 10 * p + c));
  for (const char* key : {"MBSDF_DATA=\n", "MBSDF_DATA_REFLECTION=\n"}) {
    test::write_file(folder / "m.mbsdf", mbsdf(1, 2, 3, values, key));
    const auto brdf = load_brdf(folder / "m.mbsdf");
    // Centres: theta 22.5 and 67.5 degrees, phi 30, 90, 150 degrees.
    for (int i = 0; i < 2; ++i)
      for (int o = 0; o < 2; ++o)
        for (int p = 0; p < 3; ++p) {
          const double azimuth = (p + 0.5) * pi / 3;
          for (const double turned : {azimuth, -azimuth}) {
            const auto f = brdf->value({direction((i + 0.5) * pi / 4, 1), direction((o + 0.5) * pi / 4, 1 + turned)});
            for (int c = 0; c < 3; ++c) EXPECT_NEAR((*f)[c], 1000 * i + 100 * o + 10 * p + c, 1e-9);
          }
        }
    // Half-way between two centres of phi, and constant beyond the last.
    EXPECT_NEAR(brdf->value({direction(pi / 8, 0), direction(pi / 8, pi / 3)})->r, 5, 1e-9);
    EXPECT_NEAR(brdf->value({direction(pi / 8, 0), direction(pi / 8, pi)})->r, 20, 1e-9);
  }
}

TEST(Mbsdf, ScalarFilesAreGrey) {
  TemporaryFolder folder;
  test::write_file(folder / "m.mbsdf", mbsdf(0, 1, 1, {0.25f}));
  EXPECT_EQ(*load_brdf(folder / "m.mbsdf")->value({direction(1, 0), direction(0.2, 2)}), glm::dvec3(0.25));
}

TEST(Mbsdf, ReadsBackTheModelsValuesAtTheCellCentres) {
  TemporaryFolder folder;
  const CookTorranceBrdf paint(test::table1_paint("polaris-silber"));
  write_mbsdf(folder / "m.mbsdf", paint, {.n_theta = 12, .n_phi = 18, .description = "a \"quoted\"\nMBSDF_DATA=\nline"});
  const auto read = load_brdf(folder / "m.mbsdf");
  for (int i = 0; i < 12; ++i)
    for (int o = 0; o < 12; ++o)
      for (int p = 0; p < 18; ++p) {
        const Directions d{direction((i + 0.5) * pi / 24, 2), direction((o + 0.5) * pi / 24, 2 + (p + 0.5) * pi / 18)};
        const glm::dvec3 f = *paint.value(d);
        EXPECT_NEAR(read->value(d)->g / f.g, 1, 1e-6);
      }
}

TEST(Mbsdf, BaseOfAPaintIsWithinAPercentButNotItsClearCoat) {
  TemporaryFolder folder;
  CookTorrance model = test::table1_paint("polaris-silber");
  const auto error = [&] {
    const CookTorranceBrdf paint(model);
    write_mbsdf(folder / "m.mbsdf", paint);
    return relative_error(paint, *load_brdf(folder / "m.mbsdf"), 75 * pi / 180);
  };
  const RelativeError whole = error();
  model.lobes.pop_back();
  const RelativeError base = error();
  EXPECT_LT(base.mean, 0.001);
  EXPECT_LT(base.max, 0.06);  // measured 4.5 %: across the kinks of G
  EXPECT_GT(whole.max, 0.5);  // 1 degree cells against a lobe of 0.74 degrees
}

TEST(Mbsdf, DamagedFilesAreErrorsBeforeAllocation) {
  TemporaryFolder folder;
  const auto expect = [&](const std::string& content, const std::vector<std::string>& parts) {
    test::write_file(folder / "m.mbsdf", content);
    expect_file_error([&] { load_brdf(folder / "m.mbsdf"); }, parts);
  };
  const std::string whole = mbsdf(1, 2, 2, std::vector<float>(24, 1.0f));
  for (std::size_t size = 20; size < whole.size(); ++size) expect(whole.substr(0, size), {"m.mbsdf"});
  expect(mbsdf(2, 1, 1, {1}), {"type: expected 0 (scalar) or 1 (RGB), got 2"});
  expect(mbsdf(1, 0xffffffffu, 0xffffffffu, {1}), {"resolution of theta: expected 1 to 4096, got 4294967295"});
  expect(mbsdf(1, 4096, 4096, {1}), {"has 4 bytes of data, expected 824633720832"});
  expect(mbsdf(0, 1, 1, {NAN}), {"value 0: expected a number, got nan"});
  expect(mbsdf(0, 1, 1, {1}, "MBSDF_DATA_TRANSMISSION=\n"), {"a measurement of reflection"});
}

}  // namespace
}  // namespace lacquer::brdf
