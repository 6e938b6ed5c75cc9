#include <fmt/format.h>

#include <glm/geometric.hpp>

#include "libacquire/lens_residuals.h"
#include "libbrdf/error.h"
#include "test_support.h"

namespace lacquer::acquire {
namespace {

/// As mrcal-calibrate-cameras writes it, its optimization inputs cut short.
constexpr const char* of_mrcal = R"(# generated on 2024-01-01
{
    'lensmodel':  'LENSMODEL_OPENCV4',

    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....
    'intrinsics': [ 1761.181055, 1761.250444, 1965.706996, 1087.518797, -0.01266096516, 0.03590794372, -0.0002547045941, 0.0005275929652,],

    'valid_intrinsics_region': [
    [ 0, 0 ],
    [ 3904, 0 ],
],

    # extrinsics are rt_fromref
    'extrinsics': [ 2e-2, -3e-1, -1e-2,  1., 2, -3.,],

    'imagersize': [ 4000, 2200,],

    'icam_intrinsics': 0,
    'optimization_inputs': b'P)h>@0001F000O8Q$s`;0001-`aJ*u08jt`)Bpeg',

}
)";

std::string without(std::string text, const std::string& part, const std::string& instead = "") {
  const auto at = text.find(part);
  EXPECT_NE(at, std::string::npos) << part;
  return text.replace(at, part.size(), instead);
}

std::string error_of(const std::string& text) {
  try {
    const Lens lens = parse_lens(text, "x.cameramodel");
    camera_of(lens, "x.cameramodel");
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::file);
    return e.what();
  }
  return "no error";
}

TEST(LensFile, AFileOfMrcalIsRead) {
  const Lens lens = parse_lens(of_mrcal, "x.cameramodel");
  EXPECT_EQ(lens.model, "LENSMODEL_OPENCV4");
  EXPECT_EQ(lens.width, 4000);
  EXPECT_EQ(lens.height, 2200);
  ASSERT_EQ(lens.intrinsics.size(), 8u);
  EXPECT_EQ(lens.intrinsics[1], 1761.250444);
  EXPECT_TRUE(lens.covariance.empty());
  const CameraModel camera = camera_of(lens, "x.cameramodel");
  EXPECT_EQ(camera.centre, glm::dvec2(1965.706996, 1087.518797));
  EXPECT_EQ(camera.distortion, (std::array<double, 8>{-0.01266096516, 0.03590794372, -0.0002547045941, 0.0005275929652}));
}

TEST(LensFile, WhatIsWrittenReadsBackToTheSameNumbers) {
  Lens lens{"LENSMODEL_OPENCV8", 640, 480, {536.123456789012345, 1. / 3, 342, 235, -0.26, 1e-17, 3, 4, 5, 6, 7, -8e-8}, {}};
  for (std::size_t i = 0; i < 144; ++i) lens.covariance.push_back(i % 13 == 0 ? static_cast<double>(i + 1) / 3 : 0);
  const Lens again = parse_lens(cameramodel_text(lens, "a note", "abc"), "x");
  EXPECT_EQ(again.model, lens.model);
  EXPECT_EQ(again.intrinsics, lens.intrinsics);
  ASSERT_EQ(again.covariance.size(), lens.covariance.size());
  for (std::size_t i = 0; i < 144; ++i) EXPECT_NEAR(again.covariance[i], lens.covariance[i], 1e-8 * lens.covariance[i]);
}

TEST(LensFile, OtherModelsAreReadButNotUsed) {
  const std::string cahvor = without(without(of_mrcal, "OPENCV4", "CAHVOR"), "0.0005275929652,", "0.0005275929652, 1");
  EXPECT_EQ(parse_lens(cahvor, "x").intrinsics.size(), 9u);
  EXPECT_EQ(error_of(cahvor).substr(0, 64), "x.cameramodel: lensmodel: LENSMODEL_CAHVOR cannot be used in a r");
  std::string spline = fmt::format("{{'lensmodel': 'LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=11_Ny=8_fov_x_deg=60', 'imagersize': [10, 8], 'extrinsics': [0,0,0,0,0,0], 'intrinsics': [100, 100, 5, 4, {}]}}",
                                   fmt::join(std::vector<int>(176, 0), ","));
  EXPECT_EQ(parse_lens(spline, "x").intrinsics.size(), 180u);
}

TEST(LensFile, HostileTextIsRefusedInOneLine) {
  const std::string good = of_mrcal;
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"", "'{' is missing"},
      {"{", "a quoted text is missing"},
      {"import os", "'{' is missing"},
      {good + "x", "text after the closing brace"},
      {good.substr(0, 300), "is missing"},
      {without(good, "'lensmodel':  'LENSMODEL_OPENCV4',"), "lensmodel: missing"},
      {without(good, "OPENCV4", "OPENCV4\\x00"), "none of mrcal's lens models"},
      {without(good, "OPENCV4", "FISHEYE"), "LENSMODEL_FISHEYE is none of mrcal's lens models"},
      {without(good, "LENSMODEL_OPENCV4", "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=9999_Ny=9999_fov_x_deg=60"), "none of mrcal's lens models"},
      {without(good, "1761.250444", "nan"), "\"nan\" is not a finite number"},
      {without(good, "1761.250444", "1e999"), "is not a finite number"},
      {without(good, "1761.250444", "-3"), "intrinsics[1]: expected a focal length"},
      {without(good, "1761.250444,"), "intrinsics: expected 8 numbers"},
      {without(good, "1761.250444", "__import__('os')"), "is not a finite number"},
      {without(good, "[ 4000, 2200,]", "[ 4000.5, 2200,]"), "imagersize: expected pixels"},
      {without(good, "[ 4000, 2200,]", "[ 4000, 0,]"), "imagersize: expected pixels"},
      {without(good, "[ 4000, 2200,]", "4000"), "imagersize: expected 2 numbers"},
      {without(good, "'imagersize': [ 4000, 2200,],"), "imagersize: missing"},
      {without(good, "'extrinsics'", "'elsewhere'"), "extrinsics: missing"},
      {without(good, "[ 4000, 2200,]", std::string(100000, '[')), "nested more than 3 deep"},
      {without(good, "'imagersize'", "'lacquer_intrinsics_covariance': [1, 2], 'imagersize'"), "lacquer_intrinsics_covariance: expected 64 numbers"},
      {without(good, "'imagersize'", fmt::format("'lacquer_intrinsics_covariance': [{}], 'imagersize'", fmt::join(std::vector<int>(64, -1), ","))), "not an element of a covariance"},
  };
  for (const auto& [text, expected] : cases) {
    const std::string error = error_of(text);
    EXPECT_NE(error.find(expected), std::string::npos) << error << " / " << expected;
    EXPECT_EQ(error.find('\n'), std::string::npos);
    EXPECT_EQ(error.substr(0, 14), "x.cameramodel:");
  }
  std::string numbers = "{'intrinsics': [";
  for (int i = 0; i < 200001; ++i) numbers += "1,";
  EXPECT_NE(error_of(numbers + "]}").find("more than 200000 numbers"), std::string::npos);
}

TEST(LensFile, ResidualsOfCornersReadBackAndDoNotDisturbTheLens) {
  const Lens lens{"LENSMODEL_PINHOLE", 640, 480, {500, 500, 320, 240}, {}};
  const std::vector<CornerResidual> corners = {{{10.5, 20.25}, {0.125, -0.25}}, {{639, 479}, {-3, 0}}};
  const std::string text = cameramodel_text(lens, "a note", "abc", corners);
  const auto again = parse_corner_residuals(text, "x");
  ASSERT_EQ(again.size(), 2u);
  EXPECT_EQ(again[0].found, corners[0].found);
  EXPECT_EQ(again[0].residual, corners[0].residual);
  EXPECT_EQ(again[1].residual, corners[1].residual);
  EXPECT_EQ(parse_lens(text, "x").intrinsics, lens.intrinsics);
  EXPECT_TRUE(parse_corner_residuals(of_mrcal, "x").empty());
}

TEST(LensFile, SoManyCornersAreWrittenThatTheFileCanBeRead) {
  const Lens lens{"LENSMODEL_PINHOLE", 640, 480, {500, 500, 320, 240}, {}};
  std::vector<CornerResidual> corners(60001);
  for (std::size_t i = 0; i < corners.size(); ++i) corners[i].found.x = static_cast<double>(i) / 1000;
  const auto again = parse_corner_residuals(cameramodel_text(lens, "", "", corners), "x");
  EXPECT_EQ(again.size(), 15001u) << "every fourth";
  EXPECT_EQ(again.back().found.x, 60);
}

TEST(LensFile, HostileResidualsAreRefused) {
  const auto error = [](const std::string& rows) -> std::string {
    try {
      parse_corner_residuals("{'lacquer_corner_residuals': " + rows + "}", "x.cameramodel");
    } catch (const Error& e) {
      return e.what();
    }
    return "no error";
  };
  EXPECT_EQ(error("[[1, 2, 3, 4], [5, 6, 7]]"), "x.cameramodel: lacquer_corner_residuals: expected rows of 4 numbers (pixel, found minus predicted), got 7 numbers");
  EXPECT_EQ(error("[[1, 2, 3, 4], [5, 6, 7, -1e6]]"), "x.cameramodel: lacquer_corner_residuals[1]: expected pixels within 1e5");
  EXPECT_NE(error("'text'").find("expected rows of 4 numbers"), std::string::npos);
  EXPECT_NE(error("[nan]").find("is not a finite number"), std::string::npos);
}

TEST(LensFile, EveryCutOfAGoodFileIsRefused) {
  const std::string good = of_mrcal;
  const auto end = good.rfind('}');
  for (std::size_t n = 0; n <= end; n += 7) EXPECT_NE(error_of(good.substr(0, n)), "no error") << n;
}

}  // namespace
}  // namespace lacquer::acquire
