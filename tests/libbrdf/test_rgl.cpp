#include <cmath>
#include <numbers>

#include "libbrdf/files.h"
#include "libbrdf/rgl_spectrum.h"
#include "tests/libbrdf/file_test_support.h"

namespace lacquer::brdf {
namespace {

using test::expect_file_error;
using test::TemporaryFolder;
using test::TensorWriter;

constexpr double pi = std::numbers::pi;

std::unique_ptr<Brdf> load(const TensorWriter& file) {
  TemporaryFolder folder;
  test::write_file(folder / "test.bsdf", file.content());
  return load_brdf(folder / "test.bsdf");
}

glm::dvec3 value(const Brdf& brdf, const Directions& d) {
  const auto f = brdf.value(d);
  EXPECT_TRUE(f);
  return f.value_or(glm::dvec3(-1));
}

/// Outgoing direction whose half vector with wi is `m`.
Directions with_half_vector(const glm::dvec3& wi, const glm::dvec3& m) {
  const double c = wi.x * m.x + wi.y * m.y + wi.z * m.z;
  return {wi, 2 * c * m - wi};
}

TEST(Rgl, ConstantGridsGiveRgbTimesDOver4SigmaCosine) {
  TensorWriter file = test::constant_rgl_file();
  file.floats("ndf", {2, 2}, std::vector<float>(4, 3.0f));
  file.floats("sigma", {2, 2}, std::vector<float>(4, 0.5f));
  std::vector<float> rgb;
  for (int theta = 0; theta < 2; ++theta)
    for (const float v : {1.0f, 2.0f, 4.0f}) rgb.insert(rgb.end(), 4, v);
  file.floats("rgb", {1, 2, 3, 2, 2}, rgb);
  const auto brdf = load(file);
  const Directions d{direction(0.3, 0.1), direction(0.9, 2.0)};
  // 3 / (4 * 0.5) = 1.5, without the cosine of wo
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(value(*brdf, d)[c], 1.5 * std::exp2(c) / std::cos(0.9), 1e-12);
  EXPECT_EQ(brdf->description().find("RGL RGB measurement"), 0u);
  EXPECT_NE(brdf->description().find("(test)"), std::string::npos);
}

TEST(Rgl, NodesLieAtTheSquareRootOfTheAngle) {
  // D = u_x at theta_m = u_x^2 pi/2 and sigma = 1 + u_x at theta_i = u_x^2 pi/2: both linear between the nodes 0 and 1.
  TensorWriter file = test::constant_rgl_file();
  file.floats("ndf", {2, 2}, {0, 1, 0, 1});
  file.floats("sigma", {2, 2}, {1, 2, 1, 2});
  const auto brdf = load(file);
  const double theta_i = 0.2, theta_m = 0.35;
  const Directions d = with_half_vector(direction(theta_i, 0.7), direction(theta_m, 1.9));
  const double u_m = std::sqrt(theta_m * 2 / pi), u_i = std::sqrt(theta_i * 2 / pi);
  EXPECT_NEAR(value(*brdf, d).g, u_m / (4 * (1 + u_i)) / d.wo.z, 1e-12);
}

TEST(Rgl, WarpIntegratesTheDensityFirstOverRowsThenWithinTheRow) {
  // Density 4 u_x u_y, exactly bilinear: cumulative u_x^2 within every row and u_y^2 over the rows.
  TensorWriter file = test::constant_rgl_file();
  file.floats("vndf", {1, 2, 2, 2}, {0, 0, 0, 5, 0, 0, 0, 7});
  std::vector<float> rgb;
  for (int theta = 0; theta < 2; ++theta)
    for (const auto& plane : {std::vector<float>{0, 1, 0, 1}, {0, 0, 1, 1}, {0, 0, 0, 1}})  // s_x, s_y, s_x s_y
      rgb.insert(rgb.end(), plane.begin(), plane.end());
  file.floats("rgb", {1, 2, 3, 2, 2}, rgb);
  const auto brdf = load(file);
  const double theta_m = 0.3, phi = 0.8;
  const Directions d = with_half_vector(direction(0.2, 0.5), direction(theta_m, 0.5 + phi));
  const double sx = theta_m * 2 / pi, sy = std::pow((phi + pi) / (2 * pi), 2);
  const glm::dvec3 f = value(*brdf, d) * 4.0 * d.wo.z;
  EXPECT_NEAR(f.r, sx, 1e-12);
  EXPECT_NEAR(f.g, sy, 1e-12);
  EXPECT_NEAR(f.b, sx * sy, 1e-12);
}

TEST(Rgl, InterpolatesLinearlyBetweenIncidentAnglesAndIsConstantBeyondThem) {
  TensorWriter file = test::constant_rgl_file();
  file.floats("theta_i", {2}, {0.25f, 0.75f});
  std::vector<float> rgb(12, 1.0f);
  rgb.resize(24, 3.0f);
  file.floats("rgb", {1, 2, 3, 2, 2}, rgb);
  const auto brdf = load(file);
  const glm::dvec3 wo = direction(0.4, 2);
  for (const auto& [theta_i, expected] : {std::pair{0.1, 1.0}, {0.25, 1.0}, {0.375, 1.5}, {0.5, 2.0}, {0.75, 3.0}, {1.4, 3.0}})
    EXPECT_NEAR(value(*brdf, {direction(theta_i, 1), wo}).r * 4 * wo.z, expected, 1e-12) << theta_i;
}

TEST(Rgl, TurningBothDirectionsChangesNothing) {
  const auto brdf = load_brdf(test::source_dir() / "data-samples/measured/vch_golden_yellow_rgb.bsdf");
  for (const double theta_i : {0.0, 0.4, 1.2})
    for (const double theta_o : {0.0, 0.4, 1.0}) {
      const glm::dvec3 at_0 = value(*brdf, {direction(theta_i, 0), direction(theta_o, 2.5)});
      for (const double turn : {0.5, 2.0, 3.14159265358979, 4.0})
        EXPECT_NEAR(value(*brdf, {direction(theta_i, turn), direction(theta_o, turn + 2.5)}).r / at_0.r, 1, 1e-9);
    }
}

TEST(Rgl, NegativeValuesOfOutOfGamutColoursReadAsZero) {
  TensorWriter file = test::constant_rgl_file();
  std::vector<float> rgb(24, 1.0f);
  for (std::size_t i = 0; i < 24; i += 12) std::fill_n(rgb.begin() + static_cast<long>(i), 4, -0.1f);
  file.floats("rgb", {1, 2, 3, 2, 2}, rgb);
  const auto f = value(*load(file), {direction(0.3, 0), direction(0.3, 1)});
  EXPECT_EQ(f.r, 0.0);
  EXPECT_GT(f.g, 0.2);
}

TEST(Rgl, SaysNothingWhereNoNormalIsVisible) {
  // Row u_y = 1 (phi_m - phi_i near pi) of the density is 0 over its whole width, and D is not.
  TensorWriter file = test::constant_rgl_file();
  file.floats("vndf", {1, 2, 3, 2}, {0, 0, 0, 0, 1, 1, 0, 0, 0, 0, 1, 1});
  const auto brdf = load(file);
  EXPECT_FALSE(brdf->value(with_half_vector(direction(0.3, 0), direction(0.4, -2.5))));
  EXPECT_TRUE(brdf->value(with_half_vector(direction(0.3, 0), direction(0.4, 2.5))));
}

TEST(Rgl, TwoEqualAzimuthsReadAsOne) {
  TensorWriter file = test::constant_rgl_file();
  file.floats("vndf", {1, 2, 2, 2}, {1, 2, 3, 4, 4, 3, 2, 1});
  const auto one = load(file);
  file.floats("phi_i", {2}, {-3.1415927f, 3.1415927f});
  file.floats("vndf", {2, 2, 2, 2}, {1, 2, 3, 4, 4, 3, 2, 1, 10, 20, 30, 40, 40, 30, 20, 10});
  file.floats("rgb", {2, 2, 3, 2, 2}, std::vector<float>(48, 1.0f));
  const auto two = load(file);
  const Directions d{direction(0.5, 0.3), direction(0.9, 2.0)};
  EXPECT_NEAR(value(*two, d).r, value(*one, d).r, 1e-6);  // the blend is rounded to float
}

TEST(Rgl, AnisotropicFilesAreAnErrorThatSaysSo) {
  TensorWriter file = test::constant_rgl_file();
  file.floats("phi_i", {3}, {-3.14f, 0, 3.14f});
  expect_file_error([&] { load(file); }, {"test.bsdf: phi_i: 3 azimuths, an anisotropic BRDF"});
}

/// Difference between the mean of both directions and the film's file in MERL layout, which another program resampled from the same
/// .bsdf at the cell centres, averaged over swapping the directions.
TEST(Rgl, MeasuredFilmAgreesWithItsMerlFileToFloatRounding) {
  LACQUER_NEEDS_SHARED_DATA("measured-brdf/vch_golden_yellow.merl.binary");
  const auto rgl = load_brdf(test::source_dir() / "data-samples/measured/vch_golden_yellow_rgb.bsdf");
  const auto merl = read_merl(test::shared_data() / "measured-brdf/vch_golden_yellow.merl.binary");
  std::vector<double> differences;
  for (std::size_t i = 0; i < TableGrid::n_cells; i += 7) {
    if (merl.channels[0].origin[i] == CellOrigin::empty) continue;
    const Directions d = directions(TableGrid::centre(i));
    const auto there = rgl->value(d), back = rgl->value({d.wo, d.wi});
    ASSERT_TRUE(there && back) << i;
    for (std::size_t c = 0; c < 3; ++c) {
      const double expected = merl.channels[c].mean[i];
      const double got = ((*there)[static_cast<int>(c)] + (*back)[static_cast<int>(c)]) / 2;
      differences.push_back(std::abs(got - expected) / std::max(expected, 1e-3));
    }
  }
  std::sort(differences.begin(), differences.end());
  const auto quantile = [&](double q) { return differences[static_cast<std::size_t>(q * static_cast<double>(differences.size() - 1))]; };
  // Measured: median 3e-7, 99.9 % below 2e-5, largest 3e-3 at grazing, where the other program's float cosines and angles lose digits.
  EXPECT_LT(quantile(0.5), 1e-6);
  EXPECT_LT(quantile(0.999), 1e-4);
  EXPECT_LT(quantile(1), 1e-2);
}

/// CIE 1931 2 degree observer, CIE 15 tables, 10 nm steps from 380 nm.
const glm::dvec3 cie_table[] = {
    {0.001368, 0.000039, 0.006450}, {0.004243, 0.000120, 0.020050}, {0.014310, 0.000396, 0.067850}, {0.043510, 0.001210, 0.207400},
    {0.134380, 0.004000, 0.645600}, {0.283900, 0.011600, 1.385600}, {0.348280, 0.023000, 1.747060}, {0.336200, 0.038000, 1.772110},
    {0.290800, 0.060000, 1.669200}, {0.195360, 0.090980, 1.287640}, {0.095640, 0.139020, 0.812950}, {0.032010, 0.208020, 0.465180},
    {0.004900, 0.323000, 0.272000}, {0.009300, 0.503000, 0.158200}, {0.063270, 0.710000, 0.078250}, {0.165500, 0.862000, 0.042160},
    {0.290400, 0.954000, 0.020300}, {0.433450, 0.994950, 0.008750}, {0.594500, 0.995000, 0.003900}, {0.762100, 0.952000, 0.002100},
    {0.916300, 0.870000, 0.001650}, {1.026300, 0.757000, 0.001100}, {1.062200, 0.631000, 0.000800}, {1.002600, 0.503000, 0.000340},
    {0.854450, 0.381000, 0.000190}, {0.642400, 0.265000, 0.000050}, {0.447900, 0.175000, 0.000020}, {0.283500, 0.107000, 0.000000},
    {0.164900, 0.061000, 0.000000}, {0.087400, 0.032000, 0.000000}, {0.046770, 0.017000, 0.000000}, {0.022700, 0.008210, 0.000000}};

TEST(RglSpectrum, MatchingFunctionsAreThoseOfTheCieTable) {
  double worst = 0;
  for (int i = 0; i < 32; ++i) {
    const glm::dvec3 error = cie_1931_matching_functions(380 + 10 * i) - cie_table[i];
    for (int c = 0; c < 3; ++c) worst = std::max(worst, std::abs(error[c]));
  }
  EXPECT_LT(worst, 0.04);  // of a peak of 1.8: the published accuracy of the fit; a wrong constant is off by far more
}

TEST(RglSpectrum, ConstantSpectrumIsWhiteWhateverTheWavelengths) {
  for (const auto& wavelengths : {std::vector<float>{400, 700}, {360, 455, 461, 500, 620, 1000}}) {
    glm::dvec3 sum(0.0);
    for (const auto& w : linear_srgb_weights(wavelengths)) sum += w;
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(sum[c], 1, 1e-12);
  }
}

TEST(RglSpectrum, LuminanceOfAStepIsThatOfTheCieTable) {
  // Reflectance 0 below 580 nm, 1 above (10 nm ramp): an orange-red. Y from the table by the trapezoid rule, equal energy.
  std::vector<float> wavelengths;
  std::vector<double> spectrum;
  double y = 0, whole = 0;
  for (int i = 0; i < 32; ++i) {
    wavelengths.push_back(static_cast<float>(380 + 10 * i));
    spectrum.push_back(i >= 20 ? 1 : 0);
    y += spectrum.back() * cie_table[i].y;
    whole += cie_table[i].y;
  }
  const auto weights = linear_srgb_weights(wavelengths);
  glm::dvec3 rgb(0.0);
  for (std::size_t l = 0; l < weights.size(); ++l) rgb += weights[l] * spectrum[l];
  // White adaptation from equal energy to D65 shifts the luminance of a saturated red by a few per cent.
  EXPECT_NEAR(0.2126 * rgb.r + 0.7152 * rgb.g + 0.0722 * rgb.b, y / whole, 0.03);
  EXPECT_GT(rgb.r, 3 * rgb.g);
  EXPECT_LT(std::abs(rgb.b), 0.05);
}

TensorWriter spectral_file(const std::vector<float>& wavelengths, const std::vector<float>& spectrum) {
  TensorWriter file = test::constant_rgl_file();
  file.remove("rgb");
  file.floats("wavelengths", {wavelengths.size()}, wavelengths);
  std::vector<float> values;
  for (int theta = 0; theta < 2; ++theta)
    for (const float s : spectrum) values.insert(values.end(), 4, s);
  file.floats("spectra", {1, 2, wavelengths.size(), 2, 2}, values);
  return file;
}

TEST(RglSpectrum, SpectralFileOfAGreyIsGrey) {
  const auto brdf = load(spectral_file({360, 500, 830}, {0.5f, 0.5f, 0.5f}));
  const Directions d{direction(0.3, 0), direction(0.5, 2)};
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(value(*brdf, d)[c] * 4 * d.wo.z, 0.5, 1e-6);
  EXPECT_EQ(brdf->description().find("RGL spectral measurement"), 0u);
}

TEST(RglSpectrum, SpectralFileOfAColourIsTheWeightedSumOfItsPlanes) {
  const std::vector<float> wavelengths{390, 450, 520, 600, 720}, spectrum{0.2f, 0.3f, 0.5f, 0.7f, 0.6f};
  const auto brdf = load(spectral_file(wavelengths, spectrum));
  const auto weights = linear_srgb_weights(wavelengths);
  glm::dvec3 rgb(0.0);
  for (std::size_t l = 0; l < weights.size(); ++l) rgb += weights[l] * double{spectrum[l]};
  const Directions d{direction(0.3, 0), direction(0.5, 2)};
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(value(*brdf, d)[c] * 4 * d.wo.z, rgb[c], 1e-6);
}

TEST(RglSpectrum, NarrowOrUnorderedWavelengthsAreAnError) {
  expect_file_error([&] { load(spectral_file({450, 500, 650}, {1, 1, 1})); }, {"wavelengths: 450 to 650 nm", "400 to 700 nm"});
  expect_file_error([&] { load(spectral_file({360, 830, 500}, {1, 1, 1})); }, {"wavelengths: expected ascending"});
}

}  // namespace
}  // namespace lacquer::brdf
