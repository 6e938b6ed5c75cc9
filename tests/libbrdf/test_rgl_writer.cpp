#include <cmath>
#include <numbers>
#include <sstream>

#include "libbrdf/files.h"
#include "libbrdf/relative_error.h"
#include "libbrdf/rgl_spectrum.h"
#include "libbrdf/rgl_warp.h"
#include "libbrdf/rgl_writer.h"
#include "tests/libbrdf/file_test_support.h"
#include "tests/libbrdf/table1_paints.h"

namespace lacquer::brdf {
namespace {

using test::TemporaryFolder;

constexpr double pi = std::numbers::pi;
constexpr double max_theta = 75 * pi / 180;

std::unique_ptr<Brdf> written_and_read(const Brdf& brdf, const RglOptions& options = {}) {
  TemporaryFolder folder;
  write_rgl(folder / "t.bsdf", brdf, options);
  return load_brdf(folder / "t.bsdf");
}

TEST(RglWarp, SampleIsTheInverseOfInvert) {
  const std::vector<float> density{1, 0, 2, 5, 0, 0, 1, 3, 4, 0, 0, 7, 0.5f, 1, 2, 2, 0, 0, 3, 1, 2, 1, 1, 1};
  const auto warp = VisibleNormalWarp::create(density, 4, 3);
  ASSERT_TRUE(warp);
  for (std::size_t slice = 0; slice < 2; ++slice)
    for (double x = 0.03; x < 1; x += 0.1)
      for (double y = 0.02; y < 1; y += 0.1) {
        const auto s = warp->invert(warp->sample({x, y}, slice), {slice, slice, 0});
        ASSERT_TRUE(s);
        EXPECT_NEAR(s->x, x, 1e-12);
        EXPECT_NEAR(s->y, y, 1e-12);
      }
}

TEST(RglWriter, PolarisSilberReadsBackWithinATenthOfAPercentIn4MB) {
  const CookTorranceBrdf paint(test::table1_paint("polaris-silber"));
  TemporaryFolder folder;
  write_rgl(folder / "p.bsdf", paint);
  EXPECT_LT(std::filesystem::file_size(folder / "p.bsdf"), 4'300'000u);
  const auto read = load_brdf(folder / "p.bsdf");
  // Measured: 0.083 % and 0.064 %; a writer after the published description reached 0.16 % and 0.22 %.
  EXPECT_LT(relative_error(paint, *read, max_theta).mean, 0.001);
  const RelativeError specular = relative_error_near_specular(paint, *read, max_theta);
  EXPECT_LT(specular.mean, 0.001);
  EXPECT_LT(specular.max, 0.02);
  EXPECT_EQ(specular.n_lost, 0u);
}

TEST(RglWriter, EveryPaintOfTable1IsWithinAFifthOfAPercentOverAllDirections) {
  for (const auto& paint : test::table1_paints()) {
    const CookTorranceBrdf brdf(paint.model);
    const auto read = written_and_read(brdf);
    EXPECT_LT(relative_error(brdf, *read, max_theta).mean, 0.0025) << paint.name;
    EXPECT_LT(relative_error_near_specular(brdf, *read, max_theta).mean, 0.01) << paint.name;
  }
}

TEST(RglWriter, ErrorFallsWithTheNodes) {
  const CookTorranceBrdf paint(test::table1_paint("ford-f8"));
  const auto coarse = written_and_read(paint, {.n_theta_i = 8, .resolution = 16, .ndf_theta = 64, .ndf_phi = 16});
  const auto fine = written_and_read(paint, {.n_theta_i = 16, .resolution = 32, .ndf_theta = 128, .ndf_phi = 32});
  EXPECT_LT(relative_error(paint, *fine, max_theta).mean, 0.5 * relative_error(paint, *coarse, max_theta).mean);
}

TEST(RglWriter, LambertianIsWithinAThousandth) {
  const CookTorranceBrdf grey({.kd = {0.5, 0.25, 0.1}, .lobes = {}});
  const auto read = written_and_read(grey, {.n_theta_i = 64, .resolution = 64});
  EXPECT_LT(relative_error(grey, *read, max_theta).mean, 1e-3);  // cos(theta_o) is not linear between the nodes
}

TEST(RglWriter, SpectralFileHasTheSameColours) {
  const CookTorranceBrdf paint(test::table1_paint("blue"));
  const RglOptions small{.n_theta_i = 8, .resolution = 16, .ndf_theta = 64, .ndf_phi = 16};
  RglOptions spectral = small;
  spectral.spectral = true;
  const auto rgb = written_and_read(paint, small), spectra = written_and_read(paint, spectral);
  EXPECT_EQ(spectra->description().find("RGL spectral"), 0u);
  EXPECT_LT(relative_error(*rgb, *spectra, max_theta).max, 1e-4);  // float sums of 16 planes
}

TEST(RglSpectrum, UpsampledSpectraAreNonNegativeSumToOneAndGiveTheColourBack) {
  const auto spectra = upsampling_spectra();
  const auto weights = linear_srgb_weights(upsampling_wavelengths());
  ASSERT_EQ(spectra.size(), weights.size());
  for (int primary = 0; primary < 3; ++primary) {
    glm::dvec3 rgb(0.0);
    for (std::size_t l = 0; l < spectra.size(); ++l) {
      EXPECT_GE(spectra[l][primary], 0.0);
      EXPECT_NEAR(spectra[l].x + spectra[l].y + spectra[l].z, 1, 1e-8);
      rgb += weights[l] * spectra[l][primary];
    }
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(rgb[c], c == primary ? 1 : 0, 1e-8);
  }
}

/// A BRDF that says something only for directions on one side.
class HalfKnown final : public Brdf {
 public:
  std::string description() const override { return "half"; }

 private:
  std::optional<glm::dvec3> do_value(const Directions& d, const Footprint<double>&) const override {
    if (d.wo.x > 0.2) return std::nullopt;
    return glm::dvec3(0.3);
  }
};

TEST(RglWriter, HolesAreContinuedFromTheirNeighbours) {
  const HalfKnown half;
  const auto read = written_and_read(half, {.n_theta_i = 16, .resolution = 32});
  const auto f = read->value({direction(0.3, 0), direction(0.35, 0)});
  ASSERT_TRUE(f);
  EXPECT_NEAR(f->g, 0.3, 0.1);
  EXPECT_LT(relative_error(half, *read, 1.0).mean, 0.01);
}

class SaysNothing final : public Brdf {
 public:
  std::string description() const override { return "nothing"; }

 private:
  std::optional<glm::dvec3> do_value(const Directions&, const Footprint<double>&) const override { return std::nullopt; }
};

TEST(RglWriter, ABrdfWithoutAnyValueIsAnError) {
  TemporaryFolder folder;
  EXPECT_THROW(write_rgl(folder / "t.bsdf", SaysNothing(), {.n_theta_i = 4, .resolution = 8}), Error);
  EXPECT_FALSE(std::filesystem::exists(folder / "t.bsdf"));
}

TEST(RglWriter, FileAndReaderAgreeWithAnIndependentReader) {
  if (!test::python_has_numpy()) GTEST_SKIP() << "SKIPPED LOUDLY: " << test::python << " has no numpy (Debian: python3-numpy)";
  TemporaryFolder folder;
  const CookTorranceBrdf paint(test::table1_paint("polaris-silber"));
  write_rgl(folder / "p.bsdf", paint);
  std::vector<Directions> directions;
  std::string text;
  for (int i = 0; i < 400; ++i) {
    // Half of them anywhere, half near the mirror direction.
    const auto fraction = [&](double step) { return std::fmod(0.5 + step * (i + 1), 1.0); };
    const double theta_i = max_theta * fraction(0.8191725134), phi_i = 1 + i;
    const double theta_o = i % 2 ? std::clamp(theta_i + 0.05 * (fraction(0.67) - 0.5), 0.0, max_theta) : max_theta * fraction(0.6710436067);
    const double phi_o = i % 2 ? phi_i + pi + 0.05 * (fraction(0.5497) - 0.5) : 2 * pi * fraction(0.5497004779);
    directions.push_back({direction(theta_i, phi_i), direction(theta_o, phi_o)});
    std::ostringstream line;
    line.precision(17);
    line << theta_i << ',' << phi_i << ',' << theta_o << ',' << phi_o << '\n';
    text += line.str();
  }
  test::write_file(folder / "d.csv", text);
  const std::string command = test::python + " " + (test::source_dir() / "tests/libbrdf/rgl_reference.py").string() + " " +
                              (folder / "p.bsdf").string() + " " + (folder / "d.csv").string() + " > " + (folder / "out").string();
  ASSERT_EQ(std::system(command.c_str()), 0);

  const auto read = load_brdf(folder / "p.bsdf");
  std::istringstream out(test::slurp(folder / "out"));
  double anywhere = 0, specular = 0;
  for (std::size_t i = 0; i < directions.size(); ++i) {
    const glm::dvec3 ours = read->value(directions[i]).value(), truth = paint.value(directions[i]).value();
    for (int c = 0; c < 3; ++c) {
      double theirs = 0;
      out >> theirs;
      EXPECT_NEAR(theirs / ours[c], 1, 1e-6) << i;  // 9 digits printed, two orders of summation
      (i % 2 ? specular : anywhere) += std::abs(theirs / truth[c] - 1) / 600;
    }
  }
  ASSERT_TRUE(out);
  EXPECT_LT(anywhere, 0.0025);
  EXPECT_LT(specular, 0.003);
}

}  // namespace
}  // namespace lacquer::brdf
