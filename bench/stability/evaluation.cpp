#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <numbers>

#include "bench/stability/hard_case.h"
#include "libbrdf/cook_torrance_array.h"
#include "libbrdf/directions.h"
#include "libbrdf/files.h"
#include "libbrdf/table.h"

/// The model where its terms lose digits, underflow or divide by nothing. References are the paper's formula in 64-bit mantissas.
namespace lacquer::bench {

namespace {

using namespace brdf;
using Long = long double;
constexpr double pi = std::numbers::pi;

const std::vector<std::string> paints{"ford-f8", "polaris-silber", "opel-titan", "bmw-339", "2k-acrylack", "white", "blue", "blue-matte"};

CookTorrance paint(const std::string& name) { return read_model(std::filesystem::path(LACQUER_SOURCE_DIR) / "data-samples" / "paints" / (name + ".json")); }

/// ln of Günther et al. 2005, Eq. 1, for kd = 0 and one lobe of ks = 1, of directions in one plane through the normal.
Long log_formula(Long theta_i, Long theta_o, bool opposite, Long m, Long r) {
  const Long half = (opposite ? theta_i - theta_o : theta_i + theta_o) / 2, difference = (opposite ? theta_i + theta_o : theta_i - theta_o) / 2;
  const Long ni = std::cos(theta_i), no = std::cos(theta_o), nh = std::cos(half), ih = std::cos(difference), tangent = std::tan(half);
  const Long fresnel = r + (1 - r) * std::pow(1 - ih, Long(5)), shadow = std::min(Long(1), 2 * nh * std::min(ni, no) / ih);
  return std::log(fresnel) - tangent * tangent / (m * m) - std::log(m * m) - 4 * std::log(nh) + std::log(shadow) - std::log(ni) - std::log(no) - std::log(std::numbers::pi_v<Long>);
}

CookTorrance one_lobe(double m, double r) { return {glm::dvec3(0.0), {{glm::dvec3(1.0), m, r}}}; }

/// Both directions in the x-z plane; opposite sides: a mirror pair where the angles are equal.
Directions pair(double theta_i, double theta_o, bool opposite) { return {direction(theta_i, 0), direction(theta_o, opposite ? pi : 0)}; }

HardCases peak() {
  HardCases cases;
  double worst = 0;
  for (const double theta_h : {1e-3, 1e-6, 1e-9, 1e-12}) worst = std::max(worst, std::abs(half_angle_cosines(HalfDiff{theta_h, 0.7, 1.0}).tan2_theta_h / std::pow(std::tan(theta_h), 2) - 1));
  cases.push_back(at_most("half vector 1e-3 to 1e-12 rad off the normal", "tan² θh is carried apart; 1/cos² − 1 would be 0 from 1e-8 on", worst, 1e-14, " relative"));
  worst = 0;
  for (const double theta_h : {1e-3, 1e-6, 1e-9}) {
    const HalfDiff back = half_diff(directions({theta_h, 0.7, 1.0}));
    worst = std::max(worst, std::abs(back.theta_h - theta_h));
  }
  cases.push_back(at_most("the same angles over unit vectors and back", "atan2 of cross and dot products; acos would lose half the digits", worst, 4e-16, " rad"));
  const HalfDiff same = half_diff(pair(0.5, 0.5, false)), opposite = half_diff({{1, 0, 0}, {-1, 0, 0}});
  cases.push_back({"light in the camera's direction (wi = wo)", "θd and φd are exactly 0", fmt::format("{:g}, {:g}", same.theta_d, same.phi_d), same.theta_d == 0 && same.phi_d == 0});
  cases.push_back({"wi = −wo, which has no half vector", "θh = 0, θd = 90° by convention, nothing is divided by 0", fmt::format("{:g}, {:g}°", opposite.theta_h, opposite.theta_d * 180 / pi), opposite.theta_h == 0 && std::abs(opposite.theta_d - pi / 2) < 1e-15});
  return cases;
}

HardCases grazing() {
  HardCases cases;
  double worst = 0;
  for (const double below : {1e-1, 1e-3, 1e-6, 1e-9}) {
    const double theta = pi / 2 - below;
    const double log_value = one_lobe(0.17, 0.92).log_value(half_angle_cosines(pair(theta, theta, true))).x;
    worst = std::max(worst, std::abs(static_cast<double>(static_cast<Long>(log_value) - log_formula(theta, theta, true, 0.17L, 0.92L))));
  }
  // The reference's own angle is the double's; its cosine near 90 degrees carries that rounding, 1e-16 / 1e-9.
  cases.push_back(at_most("mirror pair 0.1 to 1e-9 rad above the horizon", "G / ((n·wi)(n·wo)) is formed with the cosines divided out by hand", worst, 1e-6, " in ln f"));
  std::size_t bad = 0, n = 0;
  for (const std::string& name : paints) {
    const CookTorrance model = paint(name);
    for (double a = 1e-12; a < 1.5; a *= 3)
      for (double b = 1e-12; b < 1.5; b *= 3)
        for (const bool opposite : {false, true}) {
          const auto f = CookTorranceBrdf(model).value(pair(pi / 2 - a, pi / 2 - b, opposite));
          for (int c = 0; c < 3; ++c, ++n) bad += !(f && std::isfinite((*f)[c]) && (*f)[c] >= 0);
        }
  }
  cases.push_back({"both directions down to 1e-12 rad above the horizon, eight paints", "finite and not negative", fmt::format("{} of {} values are not", bad, n), bad == 0});
  return cases;
}

HardCases underflow() {
  HardCases cases;
  double worst = 0;
  for (const double m : {0.001, 0.013, 0.17})
    for (const double theta_h : {0.2, 0.7, 1.2, 1.4}) {
      const double log_value = one_lobe(m, 0.9).log_value(half_angle_cosines(pair(theta_h + 0.05, theta_h - 0.05, false))).x;
      const Long expected = log_formula(static_cast<Long>(theta_h) + 0.05L, static_cast<Long>(theta_h) - 0.05L, false, static_cast<Long>(m), 0.9L);
      worst = std::max(worst, std::abs(static_cast<double>((static_cast<Long>(log_value) - expected) / expected)));
    }
  cases.push_back(at_most("a lobe of m = 0.001 to 0.17 at θh = 11° to 80°, down to ln f = −3e7", "log_value stays finite and right where exp is 0 in double below −745", worst, 1e-13, " relative, in ln f"));
  CookTorrance three{glm::dvec3(0.0), {{glm::dvec3(1.0), 0.02, 0.5}, {glm::dvec3(1.0), 0.019, 0.5}, {glm::dvec3(1.0, 1.0, 0.0), 0.013, 0.5}}};
  const glm::dvec3 sum = three.log_value(half_angle_cosines(pair(1.05, 0.95, false)));
  const auto single = one_lobe(0.02, 0.5).log_value(half_angle_cosines(pair(1.05, 0.95, false)));
  cases.push_back(at_most("three lobes that all underflow, no diffuse part", "log-sum with the largest factored out", std::abs(sum.x / single.x - 1), 1e-15, " relative, of the widest lobe alone"));
  const double nothing = CookTorrance{}.log_value(half_angle_cosines(pair(0.3, 0.4, true))).x;
  cases.push_back({"a model without any reflection", "ln f is −∞, f is 0, never NaN", fmt::format("{:g}", nothing), nothing == -std::numeric_limits<double>::infinity()});
  return cases;
}

HardCases single_precision() {
  double worst = 0, worst_array = 0;
  std::size_t bad = 0;
  std::array<std::vector<float>, 5> c;
  std::vector<HalfAngleCosines<double>> exact;
  for (std::size_t i = 0; i < TableGrid::n_cells; i += 29) {
    if (!TableGrid::reachable(TableGrid::cell(i), 1e-3)) continue;
    const auto d = half_angle_cosines(TableGrid::centre(i));
    const std::array<double, 5> values{d.n_dot_i, d.n_dot_o, d.n_dot_h, d.i_dot_h, d.tan2_theta_h};
    for (std::size_t k = 0; k < 5; ++k) c[k].push_back(static_cast<float>(values[k]));
    exact.push_back({c[0].back(), c[1].back(), c[2].back(), c[3].back(), c[4].back(), {}});
  }
  std::array<std::vector<float>, 3> out, scalar;
  for (auto* set : {&out, &scalar})
    for (auto& o : *set) o.resize(exact.size());
  bool same = true;
  for (const std::string& name : paints) {
    const CookTorrance model = paint(name);
    const CosineArrays arrays{c[0].data(), c[1].data(), c[2].data(), c[3].data(), c[4].data()};
    float* const pointers[]{out[0].data(), out[1].data(), out[2].data()};
    float* const scalar_pointers[]{scalar[0].data(), scalar[1].data(), scalar[2].data()};
    evaluate(model, arrays, exact.size(), pointers);
    use_vector_evaluation(false);
    evaluate(model, arrays, exact.size(), scalar_pointers);
    use_vector_evaluation(true);
    same = same && out == scalar;
    for (std::size_t i = 0; i < exact.size(); ++i) {
      const glm::dvec3 f = model.value(exact[i]);
      const glm::vec3 g = model.value(HalfAngleCosines<float>{c[0][i], c[1][i], c[2][i], c[3][i], c[4][i], {}});
      for (int k = 0; k < 3; ++k) {
        bad += !std::isfinite(g[k]) || !std::isfinite(out[static_cast<std::size_t>(k)][i]);
        worst = std::max(worst, std::abs(static_cast<double>(g[k]) / f[k] - 1));
        worst_array = std::max(worst_array, std::abs(static_cast<double>(out[static_cast<std::size_t>(k)][i]) / f[k] - 1));
      }
    }
  }
  const std::string where = fmt::format("float at {} directions up to 89.9°, eight paints", exact.size());
  return {at_most(where + ", one by one", fmt::format("{} values not finite", bad), worst, 1e-5, " relative"),
          at_most("the same in arrays (AVX2 or not)", same ? "the same bytes with and without AVX2" : "bytes differ with and without AVX2", same ? worst_array : NAN, 1e-5, " relative")};
}

HardCases extremes() {
  HardCases cases;
  double worst = 0;
  const auto at = half_angle_cosines(HalfDiff{1e-6, 0.4, 0.2});
  for (const double m : {1e-6, 1e-3, 1.0}) {
    const Long expected = std::log(0.5L + 0.5L * std::pow(1 - std::cos(0.4L), Long(5))) - std::pow(std::tan(1e-6L) / static_cast<Long>(m), Long(2)) - 2 * std::log(static_cast<Long>(m)) - 4 * std::log(std::cos(1e-6L)) -
                          std::log(static_cast<Long>(at.n_dot_i) * static_cast<Long>(at.n_dot_o)) - std::log(std::numbers::pi_v<Long>);
    worst = std::max(worst, std::abs(static_cast<double>((static_cast<Long>(one_lobe(m, 0.5).log_value(at).x) - expected) / expected)));
  }
  cases.push_back(at_most("m = 1e-6 (the smallest that a file may hold), 1e-3, 1", "the exponent is formed in slopes, no 1 − cos²", worst, 1e-13, " relative, in ln f"));
  double integral = 0;  // of D cos over the hemisphere, with a footprint 10 times as wide as the lobe: still pi
  auto lobe = CookTorranceLobe<double>{0.01, 1.0};
  for (int i = 0; i < 20000; ++i) {
    const double slope = (i + 0.5) * 1e-4;
    HalfAngleCosines<double> c{1, 1, 1, 1, slope * slope, {0.01, 0.01, 0}};  // cosines 1: the lobe over slopes
    integral += lobe(c) * 2 * pi * slope * 1e-4;
  }
  cases.push_back(at_most("a footprint ten times as wide as the lobe", "the widened lobe keeps its energy", std::abs(integral - 1), 1e-6, " off 1"));
  double lowest = 1, highest = 0;
  for (const double r : {0.0, 1e-12, 0.04, 0.9, 0.99})
    for (double cosine = 1e-12; cosine <= 1; cosine *= 1.1) {
      const double f = dielectric_reflectance(r, cosine);
      lowest = std::min(lowest, f), highest = std::max(highest, f);
      if (!std::isfinite(f)) lowest = NAN;
    }
  cases.push_back({"exact Fresnel reflectance, r = 0 to 0.99, to 1e-12 rad above the horizon", "within [0, 1]", fmt::format("{:.2g} to {:.17g}", lowest, highest), lowest >= 0 && highest <= 1});
  return cases;
}

}  // namespace

HardCases evaluation_cases() {
  HardCases all;
  for (const auto& part : {peak(), grazing(), underflow(), single_precision(), extremes()}) all.insert(all.end(), part.begin(), part.end());
  return all;
}

}  // namespace lacquer::bench
