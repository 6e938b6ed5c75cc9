#include "libbrdf/metrics.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <glm/geometric.hpp>
#include <limits>
#include <numbers>

#include "libbrdf/error.h"
#include "libbrdf/table.h"
#include "table1_paints.h"

namespace lacquer::brdf {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double degree = pi / 180;

/// Any function of the directions as a BRDF.
class FunctionBrdf final : public Brdf {
 public:
  using Function = std::function<std::optional<glm::dvec3>(const Directions&)>;
  explicit FunctionBrdf(Function f) : f_(std::move(f)) {}
  std::string description() const override { return "function of a test"; }

 private:
  std::optional<glm::dvec3> do_value(const Directions& d, const Footprint<double>&) const override { return f_(d); }
  Function f_;
};

CookTorranceBrdf lambertian(double albedo) { return CookTorranceBrdf({glm::dvec3(albedo), {}}); }
CookTorranceBrdf paint(const std::string& name) { return CookTorranceBrdf(test::table1_paint(name)); }

void expect_all_zero(const BrdfDifference& d, double tolerance) {
  for (const double x : {d.mean_abs_log, d.rms_log, d.max_abs_log, std::abs(d.bias_log), d.cosine_rms,
                         d.delta_e_mean, d.delta_e_p95})
    EXPECT_LE(x, tolerance);
}

TEST(Metrics, IdenticalBrdfsDifferByExactlyNothing) {
  for (const bool scale : {false, true}) {
    const BrdfDifference d =
        compare(paint("polaris-silber"), paint("polaris-silber"), {.phi_d_step = 10, .scale = scale});
    expect_all_zero(d, 0.0);
    EXPECT_EQ(d.scale, 1.0);
    EXPECT_GT(d.n_directions, 50000u);
    EXPECT_EQ(d.n_undefined, 0u);
    EXPECT_EQ(d.n_nonpositive, 0u);
  }
}

TEST(Metrics, TwoLambertiansHaveTheirClosedForms) {
  const BrdfDifference d = compare(lambertian(0.5), lambertian(0.25));
  EXPECT_NEAR(d.mean_abs_log, std::log(2.0), 1e-14);
  EXPECT_NEAR(d.rms_log, std::log(2.0), 1e-14);
  EXPECT_NEAR(d.max_abs_log, std::log(2.0), 1e-14);
  EXPECT_NEAR(d.bias_log, -std::log(2.0), 1e-14);
  EXPECT_NEAR(d.cosine_rms, 0.5, 1e-14);
  EXPECT_EQ(d.scale, 1.0);
}

TEST(Metrics, ScaleRemovesAFactor) {
  const BrdfDifference d = compare(lambertian(0.5), lambertian(0.25), {.phi_d_step = 4, .scale = true});
  EXPECT_NEAR(d.scale, 2.0, 1e-14);
  EXPECT_NEAR(d.mean_abs_log, 0, 1e-14);
  EXPECT_NEAR(d.cosine_rms, 0, 1e-14);
  EXPECT_NEAR(d.delta_e_mean, 0, 1e-5);  // pictures are float
}

TEST(Metrics, ScaleMakesTheMeanLogRatioZeroWhateverTheShapes) {
  const BrdfDifference unscaled = compare(paint("white"), paint("blue"), {.phi_d_step = 10});
  const BrdfDifference d = compare(paint("white"), paint("blue"), {.phi_d_step = 10, .scale = true});
  EXPECT_NEAR(d.bias_log, 0, 1e-13);
  EXPECT_NEAR(d.scale, std::exp(-unscaled.bias_log), 1e-13 * d.scale);
  EXPECT_NEAR(d.rms_log * d.rms_log,
              unscaled.rms_log * unscaled.rms_log - unscaled.bias_log * unscaled.bias_log, 1e-12);
  // Scaling inside equals scaling the BRDF.
  const FunctionBrdf scaled(
      [&](const Directions& w) { return std::optional(d.scale * *paint("blue").value(w)); });
  const BrdfDifference outside = compare(paint("white"), scaled, {.phi_d_step = 10});
  EXPECT_NEAR(outside.mean_abs_log, d.mean_abs_log, 1e-12);
  EXPECT_NEAR(outside.cosine_rms, d.cosine_rms, 1e-12 * d.cosine_rms);
  EXPECT_NEAR(outside.delta_e_mean, d.delta_e_mean, 1e-4);  // pictures are float
}

TEST(Metrics, LogMeasuresDoNotChangeWhenTheTwoAreSwapped) {
  const CookTorranceBrdf a = paint("bmw-339"), b = paint("opel-titan");
  const BrdfDifference ab = compare(a, b, {.phi_d_step = 10}), ba = compare(b, a, {.phi_d_step = 10});
  EXPECT_EQ(ab.mean_abs_log, ba.mean_abs_log);
  EXPECT_EQ(ab.rms_log, ba.rms_log);
  EXPECT_EQ(ab.max_abs_log, ba.max_abs_log);
  EXPECT_EQ(ab.bias_log, -ba.bias_log);
  EXPECT_NEAR(ab.delta_e_mean, ba.delta_e_mean, 1e-12);
  EXPECT_NE(ab.cosine_rms, ba.cosine_rms);  // relative to A
  EXPECT_GT(ab.mean_abs_log, 0.0);
}

TEST(Metrics, CosineRmsIntegratesOverSolidAngle) {
  // a = 1, b = 1 + cos_i cos_o: the square is int cos^4 dw int cos^4 dw / (int cos^2 dw int cos^2 dw), over
  // cosines from c to 1 (1 - c^5)/5 and (1 - c^3)/3 each.
  const FunctionBrdf a([](const Directions&) { return glm::dvec3(1.0); });
  const FunctionBrdf b([](const Directions& d) { return glm::dvec3(1 + d.wi.z * d.wo.z); });
  for (const double max_theta : {90 * degree, 60 * degree}) {
    const double c = std::cos(max_theta);
    const double expected = ((1 - std::pow(c, 5)) / 5) / ((1 - std::pow(c, 3)) / 3);  // 0.6 at 90 deg
    // Cells are whole or not at all at the limit: 1 deg of 60.
    EXPECT_NEAR(compare(a, b, {.max_theta = max_theta, .phi_d_step = 1}).cosine_rms, expected, 2e-3)
        << max_theta;
  }
}

TEST(Metrics, DirectionsStayWithinMaxTheta) {
  const double limit = 40 * degree;
  std::size_t cells = 0;
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i)
    cells += TableGrid::reachable(TableGrid::cell(i), std::cos(limit));
  const FunctionBrdf constant([](const Directions&) { return glm::dvec3(1.0); });
  EXPECT_EQ(compare(constant, constant, {.max_theta = limit, .phi_d_step = 1}).n_directions, cells);
}

TEST(Metrics, CubeRootOfConstantsByHand) {
  // cbrt(cos_i) (2 - 1) with a = 1, b = 8: the mean of cos_i^(2/3) over directions, its square root. wi within 90 degrees of the normal, both
  // directions weighed by their solid angles: the mean over the hemisphere is the integral of c^(2/3) dc from 0 to 1, 3/5.
  const FunctionBrdf one([](const Directions&) { return glm::dvec3(1.0); }), eight([](const Directions&) { return glm::dvec3(8.0); });
  EXPECT_NEAR(compare(one, eight, {.max_theta = 89.9 * degree, .phi_d_step = 1}).cube_root_rms, std::sqrt(0.6), 5e-3);
  EXPECT_EQ(compare(one, one, {.phi_d_step = 30}).cube_root_rms, 0);
  EXPECT_NEAR(compare(one, eight, {.phi_d_step = 30, .scale = true}).cube_root_rms, 0, 1e-12);
  const FunctionBrdf black([](const Directions&) { return glm::dvec3(0, 1, 1); });  // one channel differs by 1 of 3
  EXPECT_NEAR(compare(one, black, {.phi_d_step = 30}).cube_root_rms * std::sqrt(3.0), compare(one, eight, {.phi_d_step = 30}).cube_root_rms, 1e-12);
}

TEST(Metrics, HolesAreCountedAndLeftOut) {
  // B says nothing for theta_h above 30 deg and is twice A elsewhere.
  const FunctionBrdf holes([](const Directions& d) -> std::optional<glm::dvec3> {
    if (half_diff(d).theta_h > 30 * degree) return std::nullopt;
    return glm::dvec3(2.0);
  });
  const FunctionBrdf one([](const Directions&) { return glm::dvec3(1.0); });
  const BrdfDifference whole = compare(one, one, {.phi_d_step = 10}),
                       d = compare(one, holes, {.phi_d_step = 10});
  EXPECT_GT(d.n_undefined, 0u);
  EXPECT_EQ(d.n_directions + d.n_undefined, whole.n_directions);
  EXPECT_NEAR(d.mean_abs_log, std::log(2.0), 1e-14);
  EXPECT_NEAR(d.cosine_rms, 1.0, 1e-14);
  EXPECT_LT(d.n_pixels, whole.n_pixels);
  EXPECT_GT(d.n_pixels, 0u);
}

TEST(Metrics, ATableDiffersFromItsModelOnlyByItsFloats) {
  const CookTorranceBrdf model = paint("blue-matte");
  const TableBrdf table(tabulate_brdf(model), "table");
  const BrdfDifference d = compare(model, table, {.phi_d_step = 10});
  EXPECT_LT(d.max_abs_log, 1e-6);  // interpolation at the centres is exact but for float entries
  EXPECT_EQ(d.n_undefined, 0u);
  EXPECT_LT(d.delta_e_mean, 0.5);  // between the centres it is not
  EXPECT_GT(d.delta_e_mean, 0.0);
}

TEST(Metrics, ValuesNotAboveZeroStayOutOfTheLogOnly) {
  const FunctionBrdf a([](const Directions&) { return glm::dvec3(1.0); });
  const FunctionBrdf b([](const Directions&) { return glm::dvec3(2.0, 0.0, -1.0); });
  const BrdfDifference d = compare(a, b, {.phi_d_step = 30});
  EXPECT_EQ(d.n_nonpositive, 2 * d.n_directions);
  EXPECT_NEAR(d.mean_abs_log, std::log(2.0), 1e-14);
  EXPECT_NEAR(d.cosine_rms, std::sqrt((1 + 1 + 4) / 3.0), 1e-14);
}

TEST(Metrics, NothingInCommonIsAnErrorThatNamesBoth) {
  const FunctionBrdf nothing([](const Directions&) { return std::optional<glm::dvec3>(); });
  try {
    compare(lambertian(0.5), nothing, {.phi_d_step = 30});
    FAIL() << "no error";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::input);
    EXPECT_NE(std::string(e.what()).find("function of a test"), std::string::npos);
    EXPECT_NE(std::string(e.what()).find("80.0 deg"), std::string::npos);
  }
  EXPECT_THROW(compare(lambertian(0.5), lambertian(0.0), {.phi_d_step = 30}), Error);  // no log ratio exists
}

TEST(Metrics, AValueThatIsNotFiniteIsAnError) {
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    const FunctionBrdf broken([bad](const Directions&) { return glm::dvec3(1.0, bad, 1.0); });
    EXPECT_THROW(compare(lambertian(0.5), broken, {.phi_d_step = 30}), Error);
    EXPECT_THROW(render_lit_sphere(broken, 16), Error);
  }
}

TEST(Metrics, OptionsOutOfRangeNameTheField) {
  const auto message = [](const CompareOptions& options) -> std::string {
    try {
      options.validate();
    } catch (const Error& e) {
      return e.code() == ErrorCode::usage ? e.what() : "wrong code";
    }
    return "valid";
  };
  EXPECT_EQ(message({}), "valid");
  EXPECT_EQ(message({.max_theta = pi / 2}), "valid");
  EXPECT_EQ(message({.max_theta = 0}).rfind("max_theta:", 0), 0u);
  EXPECT_EQ(message({.max_theta = 1.6}).rfind("max_theta:", 0), 0u);
  EXPECT_EQ(message({.max_theta = std::nan("")}).rfind("max_theta:", 0), 0u);
  EXPECT_EQ(message({.phi_d_step = 0}).rfind("phi_d_step:", 0), 0u);
  EXPECT_EQ(message({.phi_d_step = 181}).rfind("phi_d_step:", 0), 0u);
}

/// CIEDE2000 of two neutral greys: |dL| / S_L.
double delta_e_of_greys(double y1, double y2) {
  const auto lightness = [](double y) {
    return y > 216.0 / 24389 ? 116 * std::cbrt(y) - 16 : 24389.0 / 27 * y;
  };
  const double l1 = lightness(y1), l2 = lightness(y2), mean50 = (l1 + l2) / 2 - 50;
  return std::abs(l1 - l2) / (1 + 0.015 * mean50 * mean50 / std::sqrt(20 + mean50 * mean50));
}

TEST(Metrics, DeltaEOfTwoLambertiansPixelByPixel) {
  // A Lambertian of albedo k shows k cos_i; 128 pixels, lights at 20, 50, 80 deg from the viewer at azimuth
  // 30 deg.
  std::vector<double> expected;
  for (const double theta : {20.0, 50.0, 80.0}) {
    const double lx = std::sin(theta * degree) * std::cos(pi / 6), ly = std::sin(theta * degree) / 2,
                 lz = std::cos(theta * degree);
    for (int row = 0; row < 128; ++row) {
      for (int column = 0; column < 128; ++column) {
        const double x = (column + 0.5) / 64 - 1, y = 1 - (row + 0.5) / 64, z2 = 1 - x * x - y * y;
        if (z2 <= 0) continue;
        const double cos_o = std::sqrt(z2), cos_i = x * lx + y * ly + cos_o * lz;
        if (std::min(cos_i, cos_o) > std::cos(80 * degree))
          expected.push_back(delta_e_of_greys(0.9 * cos_i, 0.3 * cos_i));
      }
    }
  }
  double sum = 0;
  for (const double e : expected) sum += e;
  std::sort(expected.begin(), expected.end());
  const std::size_t rank = static_cast<std::size_t>(std::ceil(0.95 * static_cast<double>(expected.size())));

  const BrdfDifference d = compare(lambertian(0.9), lambertian(0.3), {.phi_d_step = 30});
  EXPECT_EQ(d.n_pixels, expected.size());
  EXPECT_NEAR(d.delta_e_mean, sum / static_cast<double>(expected.size()), 1e-4);  // pictures are float
  EXPECT_NEAR(d.delta_e_p95, expected[rank - 1], 1e-4);
}

TEST(Metrics, ADisplayCannotShowWhatIsBrighterThanWhite) {
  // Within 80 deg both show more than 1000 cos(80 deg) = 174 times white.
  const BrdfDifference d = compare(lambertian(1000), lambertian(2000), {.phi_d_step = 30});
  EXPECT_EQ(d.delta_e_p95, 0.0);
  EXPECT_NEAR(d.mean_abs_log, std::log(2.0), 1e-14);
}

TEST(Metrics, ResultDoesNotDependOnTheNumberOfThreads) {
  const auto with_threads = [](std::size_t n) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, n);
    return compare(paint("ford-f8"), paint("blue"), {.phi_d_step = 6, .scale = true});
  };
  const BrdfDifference one = with_threads(1), four = with_threads(4);
  EXPECT_EQ(one.mean_abs_log, four.mean_abs_log);
  EXPECT_EQ(one.rms_log, four.rms_log);
  EXPECT_EQ(one.cosine_rms, four.cosine_rms);
  EXPECT_EQ(one.delta_e_mean, four.delta_e_mean);
  EXPECT_EQ(one.delta_e_p95, four.delta_e_p95);
  EXPECT_EQ(one.scale, four.scale);
}

TEST(LitSphere, AWhiteLambertianLitFromTheViewerShowsItsCosine) {
  const SphereImage image = render_lit_sphere(lambertian(1.0), 33, {{0, 0, 1}});
  ASSERT_EQ(image.radiance.size(), 33u * 33u);
  EXPECT_NEAR(image.radiance[16 * 33 + 16].y, 1.0, 1e-6);  // centre pixel of an odd size faces the viewer
  for (int row = 0; row < 33; ++row) {
    for (int column = 0; column < 33; ++column) {
      const auto normal = sphere_normal(33, column, row);
      const std::size_t i = static_cast<std::size_t>(row * 33 + column);
      ASSERT_EQ(image.covered[i], normal.has_value());
      EXPECT_NEAR(image.radiance[i].x, normal ? normal->z : 0.0, 1e-6);
    }
  }
  EXPECT_FALSE(image.covered[0]);
}

TEST(LitSphere, PixelsHoldTheModelAtTheirNormal) {
  // World-frame dot products instead of a shading frame.
  const CookTorranceBrdf brdf = paint("polaris-silber");
  const glm::dvec3 light = glm::normalize(glm::dvec3(0.5, 0.2, 0.6)), view(0, 0, 1),
                   h = glm::normalize(light + view);
  const SphereImage image = render_lit_sphere(brdf, 64, {light});
  for (int row = 0; row < 64; ++row) {
    for (int column = 0; column < 64; ++column) {
      const auto n = sphere_normal(64, column, row);
      if (!n) continue;
      const double cos_i = glm::dot(*n, light), cos_h = glm::dot(*n, h);
      const glm::vec3 shown = image.radiance[static_cast<std::size_t>(row * 64 + column)];
      if (cos_i <= 0) {
        EXPECT_EQ(shown, glm::vec3(0.0f));
        continue;
      }
      const double tan2 = glm::dot(glm::cross(*n, h), glm::cross(*n, h)) / (cos_h * cos_h);
      const glm::dvec3 expected =
          brdf.model().value(HalfAngleCosines<double>{cos_i, n->z, cos_h, glm::dot(light, h), tan2}) * cos_i *
          pi;
      EXPECT_NEAR(shown.y / expected.y, 1, 1e-6);  // float
    }
  }
}

TEST(LitSphere, LightsAdd) {
  const CookTorranceBrdf brdf = paint("white");
  const glm::dvec3 left = direction(50 * degree, pi), up = direction(30 * degree, pi / 2);
  const auto both = render_lit_sphere(brdf, 20, {left, up}), one = render_lit_sphere(brdf, 20, {left}),
             two = render_lit_sphere(brdf, 20, {up});
  for (std::size_t i = 0; i < both.radiance.size(); ++i)
    EXPECT_NEAR(both.radiance[i].y, one.radiance[i].y + two.radiance[i].y, 1e-6 * (1 + both.radiance[i].y));
}

TEST(LitSphere, TheDefaultLightComesFromTheUpperRight) {
  const SphereImage image = render_lit_sphere(lambertian(1.0), 101);
  const auto brightest = std::max_element(image.radiance.begin(), image.radiance.end(),
                                          [](auto a, auto b) { return a.x < b.x; });
  const auto index = static_cast<int>(brightest - image.radiance.begin());
  // Normal = light = (cos 30 sin 30, sin 30, cos^2 30) = (0.433, 0.5, 0.75).
  EXPECT_NEAR((index % 101 + 0.5) / 50.5 - 1, 0.433, 0.02);
  EXPECT_NEAR(1 - (index / 101 + 0.5) / 50.5, 0.5, 0.02);
}

TEST(LitSphere, HolesAreNotCovered) {
  const FunctionBrdf holes([](const Directions& d) -> std::optional<glm::dvec3> {
    if (d.wo.z < 0.5) return std::nullopt;
    return glm::dvec3(1.0);
  });
  const SphereImage image = render_lit_sphere(holes, 40, {{0, 0, 1}});
  for (int i = 0; i < 1600; ++i) {
    const auto normal = sphere_normal(40, i % 40, i / 40);
    EXPECT_EQ(image.covered[static_cast<std::size_t>(i)], normal && normal->z >= 0.5);
  }
}

TEST(LitSphere, NonsenseIsRefused) {
  EXPECT_THROW(render_lit_sphere(lambertian(0.5), 0), Error);
  EXPECT_THROW(render_lit_sphere(lambertian(0.5), 1 << 20), Error);
  EXPECT_THROW(render_lit_sphere(lambertian(0.5), 8, {{0, 0, 2}}), Error);
  EXPECT_THROW(render_lit_sphere(lambertian(0.5), 8, {{0, 0, std::nan("")}}), Error);
}

}  // namespace
}  // namespace lacquer::brdf
