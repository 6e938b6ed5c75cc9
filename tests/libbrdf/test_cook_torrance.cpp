#include "libbrdf/cook_torrance.h"

#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <limits>
#include <numbers>
#include <random>

#include "libbrdf/brdf.h"
#include "table1_paints.h"

namespace lacquer::brdf {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double degree = pi / 180;

Directions pair_of(double theta_i_deg, double phi_i_deg, double theta_o_deg, double phi_o_deg) {
  return {direction(theta_i_deg * degree, phi_i_deg * degree),
          direction(theta_o_deg * degree, phi_o_deg * degree)};
}

/// Uniform pairs of directions above the horizon, every fourth close to a mirror pair (the peak of a clear
/// coat).
std::vector<Directions> random_pairs(int n) {
  std::mt19937_64 generator(1982);
  std::uniform_real_distribution<double> uniform(0, 1);
  std::vector<Directions> pairs;
  for (int i = 0; i < n; ++i) {
    const glm::dvec3 wi = direction(std::acos(uniform(generator)), 2 * pi * uniform(generator));
    glm::dvec3 wo = direction(std::acos(uniform(generator)), 2 * pi * uniform(generator));
    if (i % 4 == 0) wo = glm::normalize(glm::dvec3(-wi.x, -wi.y, wi.z) + 0.03 * wo);
    pairs.push_back({wi, wo});
  }
  return pairs;
}

HalfAngleCosines<float> to_float(const HalfAngleCosines<double>& c) {
  return {static_cast<float>(c.n_dot_i), static_cast<float>(c.n_dot_o), static_cast<float>(c.n_dot_h),
          static_cast<float>(c.i_dot_h), static_cast<float>(c.tan2_theta_h)};
}

void expect_relative(double value, double expected, double tolerance) {
  EXPECT_NEAR(value, expected, tolerance * std::abs(expected));
}

TEST(CookTorrance, OneLobeByHand) {
  const auto value = [](double m, double r, const Directions& d) {
    return CookTorrance{glm::dvec3(0.0), {{glm::dvec3(pi), m, r}}}.value(half_angle_cosines(d)).x;
  };
  // Normal incidence and view: D = 1/m^2, F = r, G = 1.
  expect_relative(value(0.5, 0.5, pair_of(0, 0, 0, 0)), 2.0, 1e-15);
  // Mirror pair at 60 deg: D = 1/m^2, F = r + (1 - r)/32, G = min(1, 2 * 1 * 0.5 / 0.5) = 1, cosines 1/4.
  expect_relative(value(0.5, 0.5, pair_of(60, 0, 60, 180)), 4 * (0.5 + 0.5 / 32) * 4, 1e-14);
  // Retroreflection at 60 deg: theta_h = 60 deg, tan^2 = 3, cos^4 = 1/16, F = r, G = 2 * 0.5 * 0.5 / 1 = 0.5.
  expect_relative(value(1.0, 0.5, pair_of(60, 10, 60, 10)), 0.5 * 16 * std::exp(-3.0) * 0.5 / 0.25, 1e-14);
}

TEST(CookTorrance, DiffusePartIsKdOverPi) {
  const CookTorrance lambert{glm::dvec3(0.1, 0.5, 1.0), {}};
  const glm::dvec3 f = lambert.value(half_angle_cosines(pair_of(70, 10, 20, 200)));
  EXPECT_DOUBLE_EQ(f.x, 0.1 / pi);
  EXPECT_DOUBLE_EQ(f.y, 0.5 / pi);
  EXPECT_DOUBLE_EQ(f.z, 1.0 / pi);
}

struct Reference {
  double theta_i, phi_i, theta_o, phi_o;  // degrees
  double rgb[3];                          // 1/sr
};

/// Printed by cook_torrance_reference.py: the formula of Günther et al. 2005, Table 1, with 60 digits.
const std::vector<std::pair<std::string, std::vector<Reference>>> references = {
    {"polaris-silber",
     {
         {0, 0, 0, 0, {14.83655713625354, 23.554945765079122, 26.961001228149695}},
         {30, 0, 30.5, 180, {17.940551535958793, 28.413615043872, 32.493434879668972}},
         {30, 0, 31.2, 178, {6.8017184447128458, 10.311991722371334, 11.606585839372142}},
         {45, 0, 20, 90, {0.085696461283384761, 0.10600027659048199, 0.11475221497546214}},
         {60, 10, 60, 10, {0.017507048091295257, 0.020053528318768276, 0.022600007809886611}},
         {75, 0, 70, 180, {13.627987328711764, 16.233874638656287, 16.384931041940468}},
         {75, 0, 10, 0, {0.020075074875422482, 0.023293192877077041, 0.026076720994273532}},
         {80, 0, 80, 175, {8.691888963351454, 10.550827327888762, 10.876694533368076}},
         {89.9, 0, 89, 180, {140387.20952854209, 221134.71503977308, 252366.85071562283}},
         {89.9, 0, 5, 30, {0.017902499316147898, 0.020552405248582375, 0.023135387929687104}},
         {50, 20, 48, 170, {0.37254701051595946, 0.45665677603685286, 0.47889969904147602}},
         {10, 300, 65, 40, {0.053269445173991167, 0.065168843893848174, 0.071016092779790935}},
     }},
    {"white",
     {
         {0, 0, 0, 0, {12.061468983359139, 10.371601959949017, 9.1264395860846327}},
         {30, 0, 30.5, 180, {14.820384637812178, 12.736080020899801, 11.206428711473029}},
         {30, 0, 31.2, 178, {6.3958302440965085, 5.5150347404899393, 4.8450442266273057}},
         {45, 0, 20, 90, {0.19417672695439131, 0.20055041282916885, 0.17507530534837184}},
         {60, 10, 60, 10, {0.19416909518008117, 0.20054293155361329, 0.17507043817141065}},
         {75, 0, 70, 180, {1.2834309954779449, 1.1230070822576345, 0.87644349114687288}},
         {75, 0, 10, 0, {0.19416913598862367, 0.20054779718752347, 0.17507043865797406}},
         {80, 0, 80, 175, {0.49073350564455013, 0.45286484782956925, 0.36440808960344302}},
         {89.9, 0, 89, 180, {606727.00940210326, 520029.43322657139, 457892.02091170178}},
         {89.9, 0, 5, 30, {0.19416914371481316, 0.20054871838704285, 0.17507043875009399}},
         {50, 20, 48, 170, {0.19856803803446049, 0.20427030918188796, 0.17787896649868878}},
         {10, 300, 65, 40, {0.19416914635454583, 0.20054835208754926, 0.17507044238588557}},
     }},
    {"ford-f8",
     {
         {0, 0, 0, 0, {11.891543299545483, 11.052193053287699, 13.09995321173816}},
         {30, 0, 30.5, 180, {14.242509048705211, 13.23859615862461, 15.692491165536752}},
         {30, 0, 31.2, 178, {4.4935825299794467, 4.1859358166555105, 4.968513582573372}},
         {45, 0, 20, 90, {0.00094372704887867277, 0.0013487584973289759, 0.00194868454987055}},
         {60, 10, 60, 10, {0.00038197186343436907, 0.00047746482929712152, 0.00057295779516466875}},
         {75, 0, 70, 180, {0.66240774512567842, 0.87290100982641927, 1.2231513285906309}},
         {75, 0, 10, 0, {0.00038574483983016328, 0.00048331679268651661, 0.00058219773735845048}},
         {80, 0, 80, 175, {0.1733481424337344, 0.26204006125251019, 0.40681198960885695}},
         {89.9, 0, 89, 180, {111925.02525081363, 105149.75416486248, 125446.26814372908}},
         {89.9, 0, 5, 30, {0.00038220517766316172, 0.00047782670442749379, 0.00057352917694946707}},
         {50, 20, 48, 170, {0.0031136100640936118, 0.0047037769940538326, 0.0072355003469212503}},
         {10, 300, 65, 40, {0.00056397114468141018, 0.00075974942878224347, 0.0010186703206674077}},
     }},
};

TEST(CookTorrance, ThreePaintsOfTable1AgreeWithTheFormulaIn60Digits) {
  for (const auto& [name, rows] : references) {
    const CookTorrance model = test::table1_paint(name);
    for (const auto& row : rows) {
      SCOPED_TRACE(name + " theta_i " + std::to_string(row.theta_i) + " theta_o " +
                   std::to_string(row.theta_o));
      const glm::dvec3 f =
          model.value(half_angle_cosines(pair_of(row.theta_i, row.phi_i, row.theta_o, row.phi_o)));
      // Directions are rounded to 1e-16; the exponent tan^2/m^2 and 1/cos at 89.9 deg amplify that at most
      // 1e3-fold.
      for (int channel = 0; channel < 3; ++channel) expect_relative(f[channel], row.rgb[channel], 1e-12);
    }
  }
}

TEST(CookTorrance, LogOfANarrowLobeIsRightFarBelowUnderflow) {
  // Printed by cook_torrance_reference.py; exp(-1964) and below do not exist in double.
  const double expected[][2] = {{10, -176.43638448595214},
                                {30, -1964.0778403088286},
                                {60, -17740.711503145744},
                                {80, -190301.46181257793}};
  const CookTorrance model{glm::dvec3(0.0), {{glm::dvec3(1.0), 0.013, 0.9}}};
  for (const auto& [theta_h, log_value] : expected) {
    const auto c = half_angle_cosines(pair_of(theta_h + 5, 0, theta_h - 5, 0));
    expect_relative(model.log_value(c).y, log_value, 1e-13);
    if (theta_h >= 30) {
      EXPECT_EQ(model.value(c).y, 0.0);
    }
  }
}

TEST(CookTorrance, IsReciprocalPositiveAndIsotropic) {
  for (const auto& paint : test::table1_paints()) {
    for (const auto& d : random_pairs(2000)) {
      const auto c = half_angle_cosines(d);
      const glm::dvec3 f = paint.model.value(c);
      const glm::dvec3 swapped = paint.model.value(half_angle_cosines(Directions{d.wo, d.wi}));
      // A rotation re-rounds the vectors: 1e-16 in theta_h, times d(exponent) = 2 tan / m^2 < 2e4 where the
      // lobe counts.
      const auto turn = [](const glm::dvec3& w) {
        const double cosine = std::cos(1.234), sine = std::sin(1.234);
        return glm::dvec3(cosine * w.x - sine * w.y, sine * w.x + cosine * w.y, w.z);
      };
      const glm::dvec3 turned = paint.model.value(half_angle_cosines(Directions{turn(d.wi), turn(d.wo)}));
      for (int channel = 0; channel < 3; ++channel) {
        EXPECT_GT(f[channel], 0) << paint.name;
        EXPECT_EQ(f[channel], swapped[channel]) << paint.name;
        expect_relative(turned[channel], f[channel], 1e-11);
      }
    }
  }
}

TEST(CookTorrance, FloatAgreesWithDoubleForAllPaints) {
  for (const auto& paint : test::table1_paints()) {
    for (const auto& d : random_pairs(4000)) {
      const auto c = half_angle_cosines(d);
      const glm::dvec3 expected = paint.model.value(c);
      const glm::vec3 f = paint.model.value(to_float(c));
      // A dozen roundings of 6e-8, the exponent's amplified by its size, which is below 10 wherever the lobe
      // is visible.
      for (int channel = 0; channel < 3; ++channel) expect_relative(f[channel], expected[channel], 1e-5);
    }
  }
}

TEST(CookTorrance, FloatLobeLosesOnlyWhatItsExponentAmplifies) {
  const CookTorranceLobe<double> exact{0.17, 0.92};
  const CookTorranceLobe<float> lobe{0.17f, 0.92f};
  for (const auto& d : random_pairs(4000)) {
    const auto c = half_angle_cosines(d);
    const double exponent = c.tan2_theta_h / (exact.m * exact.m);
    if (exponent > 80) continue;  // float exp underflows at 87
    expect_relative(static_cast<double>(lobe(to_float(c))), exact(c), 6e-8 * (20 + 6 * exponent));
  }
}

TEST(CookTorrance, FloatIsFiniteAtTheHorizon) {
  const auto c = to_float(half_angle_cosines(pair_of(89.99999999, 0, 89.99999999, 1)));
  const float f = CookTorranceLobe<float>{0.17f, 0.92f}(c);
  EXPECT_EQ(f, 0.0f);  // tan^2 = 3e19: a NaN would come from 0 / 0 if cos^4 underflowed
}

TEST(CookTorrance, LogValueIsTheLogarithmOfTheValue) {
  for (const auto& paint : test::table1_paints()) {
    for (const auto& d : random_pairs(2000)) {
      const auto c = half_angle_cosines(d);
      const glm::dvec3 f = paint.model.value(c), log_f = paint.model.log_value(c);
      for (int channel = 0; channel < 3; ++channel) EXPECT_NEAR(log_f[channel], std::log(f[channel]), 1e-12);
    }
  }
}

TEST(CookTorrance, LogValueIsMinusInfinityOnlyWhereTheValueIsZero) {
  const auto c = half_angle_cosines(pair_of(65, 0, 55, 0));
  const CookTorrance narrow{glm::dvec3(0.0), {{glm::dvec3(1.0, 1e-300, 0.0), 0.013, 0.9}}};
  EXPECT_TRUE(std::isfinite(narrow.log_value(c).x));
  EXPECT_TRUE(std::isfinite(narrow.log_value(c).y));
  EXPECT_EQ(narrow.log_value(c).z, -std::numeric_limits<double>::infinity());
  EXPECT_EQ((CookTorrance{glm::dvec3(0.0), {}}).log_value(c).x, -std::numeric_limits<double>::infinity());
  // A lobe that is exactly 0 (ks = 0, as in 2K Acrylack) must not disturb the others.
  const CookTorrance with_zero{glm::dvec3(0.5), {{glm::dvec3(0.0), 0.88, 1.0}}};
  EXPECT_DOUBLE_EQ(with_zero.log_value(c).x, std::log(0.5 / pi));
}

TEST(CookTorrance, SchlickIsROnTheAxisAndOneAtGrazing) {
  const auto fresnel = [](double r, double theta) {
    // theta_h = 0, so D = 1/m^2 and G / cosines = 1 / cos^2 (mirror pair): divide the rest away.
    const auto c =
        half_angle_cosines(Directions{direction(theta, 0), {-std::sin(theta), 0, std::cos(theta)}});
    return CookTorranceLobe<double>{0.3, r}(c)*pi * 0.09 * c.n_dot_i * c.n_dot_o;
  };
  EXPECT_NEAR(fresnel(0.04, 0), 0.04, 1e-15);
  EXPECT_NEAR(fresnel(0.04, 60 * degree), 0.04 + 0.96 / 32, 1e-14);
  EXPECT_NEAR(fresnel(0.04, pi / 2 - 1e-9), 1.0, 1e-7);
  EXPECT_NEAR(fresnel(1.0, 40 * degree), 1.0, 1e-14);
}

TEST(CookTorrance, FresnelOfAPerfectlyBlackFacetIsNeverNegative) {
  for (const auto& d : random_pairs(2000)) {
    const auto c = half_angle_cosines(Directions{d.wi, d.wi});
    const double f = CookTorranceLobe<double>{0.8, 0.0}(c);
    EXPECT_GE(f, 0.0);
    EXPECT_LT(f, 1e-60);
  }
}

TEST(CookTorrance, GeometryTermHasTheLimitsOfThe1982Paper) {
  for (const auto& d : random_pairs(4000)) {
    const auto c = half_angle_cosines(d);
    const double g = geometry_over_cosines(c) * c.n_dot_i * c.n_dot_o;
    const double masking = 2 * c.n_dot_h * c.n_dot_o / c.i_dot_h,
                 shadowing = 2 * c.n_dot_h * c.n_dot_i / c.i_dot_h;
    EXPECT_NEAR(g, std::min({1.0, masking, shadowing}), 1e-14);
    EXPECT_GT(g, 0.0);
    EXPECT_LE(g, 1.0 + 1e-15);
  }
  // Mirror pairs are never shadowed: 2 cos(theta_h = 0) cos / cos = 2.
  EXPECT_NEAR(
      geometry_over_cosines(half_angle_cosines(pair_of(85, 0, 85, 180))) * std::pow(std::cos(85 * degree), 2),
      1, 1e-12);
  // One direction on the horizon: G / (cos cos) has the finite limit 2 cos(theta_h) / (cos(theta_d)
  // cos(theta_o)).
  const HalfAngleCosines<double> horizon{0.0, 0.8, 0.6, 0.5, 16.0 / 9};
  EXPECT_NEAR(geometry_over_cosines(horizon), 2 * 0.6 / (0.5 * 0.8), 1e-15);
}

/// Simpson's rule over x = tan(theta)/m in [0, 8], which holds a Beckmann lobe to exp(-64).
template <typename Integrand>
double integrate_over_slopes(double m, const Integrand& integrand) {
  constexpr int n = 4000;
  constexpr double step = 8.0 / n;
  double sum = 0;
  for (int i = 0; i <= n; ++i) {
    const double x = i * step, weight = i == 0 || i == n ? 1 : (i % 2 ? 4 : 2);
    sum += weight * integrand(std::atan(m * x)) * m / (1 + m * m * x * x);
  }
  return sum * step / 3;
}

TEST(CookTorrance, TheMicrofacetDistributionIntegratesToPi) {
  for (const double m : {0.013, 0.17, 0.5, 1.0}) {
    // Retroreflection (wi = wo = h, F = r) gives D = f pi cos^2 / (r min(1, 2 cos^2)).
    const auto projected = [m](double theta) {
      const auto c = half_angle_cosines(HalfDiff{theta, 0, 0});
      const double cos2 = c.n_dot_h * c.n_dot_h;
      const double distribution =
          CookTorranceLobe<double>{m, 0.5}(c)*pi * cos2 / (0.5 * std::min(1.0, 2 * cos2));
      return distribution * std::cos(theta) * 2 * pi * std::sin(theta);
    };
    EXPECT_NEAR(integrate_over_slopes(m, projected), pi, 1e-9) << m;
  }
}

TEST(CookTorrance, ANarrowLobeReflectsFourKsRAtNormalIncidence) {
  // D has no 1/pi and the lobe no 1/4: with dwo = 4 cos(theta_d) dwh the hemispherical reflectance is (4/pi)
  // ks int F D cos dw = 4 ks r.
  const double m = 0.02, r = 0.3, ks = 0.05;
  const CookTorrance model{glm::dvec3(0.0), {{glm::dvec3(ks), m, r}}};
  const double reflectance = integrate_over_slopes(m, [&](double theta_h) {
    const Directions d{{0, 0, 1}, direction(2 * theta_h, 0)};
    return model.value(half_angle_cosines(d)).x * d.wo.z * 4 * std::cos(theta_h) * 2 * pi * std::sin(theta_h);
  });
  EXPECT_NEAR(reflectance, 4 * ks * r, 1e-6);  // F - r < (1 - r) theta^10 / 32
}

TEST(CookTorrance, AFootprintIsTheConvolutionOfTheLobeWithAGaussianOfSlopes) {
  const double m = 0.1;
  const Footprint<double> v{0.004, 0.0015, 0.0012};  // longer than wide and turned
  // exp(-s^2/m^2)/m^2 of the library, from a retroreflecting lobe at slope s (see above; G = 1 for these
  // slopes).
  const auto slope_density = [&](double s) {
    auto c = half_angle_cosines(HalfDiff{std::atan(s), 0, 0});
    c.footprint = v;
    const double cos2 = c.n_dot_h * c.n_dot_h;
    const double via_value = CookTorranceLobe<double>{m, 0.5}(c)*pi * cos2 * cos2 * cos2 / 0.5;
    const double via_log =
        std::exp(CookTorranceLobe<double>{m, 0.5}.log_value(c)) * pi * cos2 * cos2 * cos2 / 0.5;
    EXPECT_NEAR(via_log / via_value, 1, 1e-12);
    return via_value;
  };
  constexpr int n = 320;
  const double det = v.along * v.across - v.mixed * v.mixed;
  const double reach = 7 * std::sqrt(v.along), step = 2 * reach / n;
  for (const double s : {0.0, 0.05, 0.15, 0.3}) {
    double blurred = 0;  // trapezium rule, exact to rounding for a Gaussian cut at 7 sigma
    for (int i = 0; i <= n; ++i) {
      for (int j = 0; j <= n; ++j) {
        const double x = -reach + i * step, y = -reach + j * step;
        const double exponent = (v.across * x * x - 2 * v.mixed * x * y + v.along * y * y) / det;
        const double density = std::exp(-exponent / 2) / (2 * pi * std::sqrt(det));
        blurred += density * std::exp(-((s - x) * (s - x) + y * y) / (m * m)) / (m * m) * step * step;
      }
    }
    EXPECT_NEAR(slope_density(s) / blurred, 1, 1e-8) << s;
  }
}

/// Directional-hemispherical reflectance of the green channel: int f cos_o dwo, lobe by lobe over the half
/// vectors.
double reflectance(const CookTorrance& paint, double theta_i) {
  const glm::dvec3 wi = direction(theta_i, 0);
  double total = paint.kd.g;
  for (const auto& lobe : paint.lobes) {
    const CookTorrance alone{glm::dvec3(0.0), {lobe}};
    constexpr int n_slope = 200, n_phi = 90;
    for (int i = 0; i < n_slope; ++i) {
      const double x = (i + 0.5) * 5 / n_slope, theta = std::atan(lobe.m * x);
      const double d_theta = 5.0 / n_slope * lobe.m / (1 + lobe.m * lobe.m * x * x);
      for (int j = 0; j < n_phi; ++j) {
        const glm::dvec3 h = direction(theta, (j + 0.5) * 2 * pi / n_phi);
        const double cos_d = glm::dot(wi, h);
        const glm::dvec3 wo = 2 * cos_d * h - wi;
        if (cos_d <= 0 || wo.z <= 0) continue;
        total += alone.value(half_angle_cosines(Directions{wi, wo})).g * wo.z * 4 * cos_d * std::sin(theta) *
                 d_theta * 2 * pi / n_phi;
      }
    }
  }
  return total;
}

TEST(CookTorrance, NoPaintOfTable1ReflectsMoreThanItReceives) {
  for (const auto& paint : test::table1_paints()) {
    for (const double theta_i : {0.0, 30 * degree, 60 * degree}) {
      const double albedo = reflectance(paint.model, theta_i);
      EXPECT_GT(albedo, paint.model.kd.g) << paint.name;
      EXPECT_LT(albedo, 1.0) << paint.name << " at " << theta_i;
    }
  }
}

TEST(CookTorrance, TheInterfaceIsBlackBelowTheHorizon) {
  const CookTorranceBrdf brdf(test::table1_paint("white"));
  EXPECT_EQ(brdf.value(Directions{{0, 0, 1}, {0.6, 0, -0.8}}).value(), glm::dvec3(0.0));
  EXPECT_EQ(brdf.value(Directions{{1, 0, 0}, {0, 0, 1}}).value(), glm::dvec3(0.0));
  EXPECT_GT(brdf.value(Directions{{0, 0, 1}, {0.6, 0, 0.8}}).value().x, 0.0);
}

}  // namespace
}  // namespace lacquer::brdf
