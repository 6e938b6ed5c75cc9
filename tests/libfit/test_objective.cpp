#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <numbers>
#include <random>

#include "fit_test_support.h"
#include "libfit/group_errors.h"
#include "libfit/objective.h"

namespace lacquer::test {
namespace {

using fit::Objective;
using fit::Observations;
using fit::ParameterLayout;

/// Observations with the table that they refer to.
struct Observed {
  std::unique_ptr<brdf::HalfAngleTable> table;
  Observations observations;
};

Observed observed(brdf::HalfAngleTable table, double model_sigma = 0.01, std::size_t max_cells = 2000) {
  Observed result{std::make_unique<brdf::HalfAngleTable>(std::move(table)), {}};
  result.observations = fit::observe(*result.table, fit::stratified_choice(fit::usable_cells(*result.table, {}), max_cells));
  fit::weigh(result.observations, model_sigma);
  return result;
}

Observed some_observations(double relative, double floor) {
  return observed(with_noise(table_of(paint("polaris-silber"), 101), relative, floor, 5));
}

/// One-channel table of cells at theta_h 0.2, theta_d 0.3 with these means.
brdf::HalfAngleTable few_cells(const std::vector<float>& means, float sigma) {
  brdf::HalfAngleTable table(1);
  brdf::TableChannel& t = table.channels[0];
  for (std::size_t k = 0; k < means.size(); ++k) {
    const double phi_d = 0.4 + 0.1 * static_cast<double>(k);
    const std::size_t i = brdf::TableGrid::index(brdf::HalfDiff{0.2, 0.3, phi_d});
    t.mean[i] = means[k], t.variance[i] = sigma * sigma, t.origin[i] = brdf::CellOrigin::measured;
    t.theta_h[i] = 0.2f, t.theta_d[i] = 0.3f, t.phi_d[i] = static_cast<float>(phi_d);
  }
  return table;
}

/// A model away from the truth, so that residuals are large and both branches of the Huber loss occur.
std::vector<double> off_truth(const ParameterLayout& layout) {
  brdf::CookTorrance model = paint("opel-titan");
  model.lobes[1].m = 0.2;
  model.lobes[2].m = 0.02;
  return layout.pack(model);
}

/// Derivative by Richardson extrapolation of central differences: error of fourth order.
template <typename F>
double numeric_derivative(const F& f, std::vector<double> x, std::size_t k) {
  const double h = 2e-4 * std::max(std::abs(x[k]), 1e-2), centre = x[k];
  const auto central = [&](double step) {
    x[k] = centre + step;
    const double up = f(x);
    x[k] = centre - step;
    return (up - f(x)) / (2 * step);
  };
  return (4 * central(h / 2) - central(h)) / 3;
}

void expect_gradient_matches(const Objective& objective, const std::vector<double>& x) {
  const fit::Quadratic q = objective.quadratic(x);
  EXPECT_NEAR(q.cost, objective.cost(x), 1e-12 * q.cost);
  for (std::size_t k = 0; k < x.size(); ++k) {
    // q.gradient is that of cost / 2.
    const double numeric = numeric_derivative([&](const auto& at) { return objective.cost(at) / 2; }, x, k);
    // Rounding of the cost over the step: 1e-16 / 1e-6; kinks of the Huber loss within the step: 1e-5 of the
    // gradient.
    EXPECT_NEAR(q.gradient[k], numeric, 1e-5 * std::abs(numeric) + 1e-8 * q.cost)
        << objective.layout().names()[k];
  }
}

/// Compares every entry with a central difference of the (separately tested) gradient.
void expect_curvature_matches(const Objective& objective, const std::vector<double>& x, fit::Curvature kind,
                              double tolerance) {
  const fit::Quadratic q = objective.quadratic(x, kind);
  const std::size_t n = x.size();
  for (std::size_t j = 0; j < n; ++j) {
    const double h = 1e-5 * std::max(std::abs(x[j]), 1e-2);
    std::vector<double> up = x, down = x;
    up[j] += h, down[j] -= h;
    const auto gradient_up = objective.quadratic(up).gradient,
               gradient_down = objective.quadratic(down).gradient;
    for (std::size_t i = 0; i < n; ++i) {
      const double numeric = (gradient_up[i] - gradient_down[i]) / (2 * h);
      const double scale = std::sqrt(std::abs(q.curvature[i * n + i] * q.curvature[j * n + j]));
      EXPECT_NEAR(q.curvature[i * n + j], numeric, tolerance * scale) << i << " " << j;
    }
  }
}

TEST(Objective, GradientEqualsDifferencesForStrongSignals) {
  const Observed seen = some_observations(0.02, 0);
  const ParameterLayout layout{3, 3};
  expect_gradient_matches(Objective(seen.observations, layout, {.robust_scale = 1e9}), off_truth(layout));
  expect_gradient_matches(Objective(seen.observations, layout, {.robust_scale = 3}), off_truth(layout));
}

TEST(Objective, GradientEqualsDifferencesForWeakSignals) {
  const Observed seen =
      some_observations(0.02, 0.02);  // base of the paint: 0.02 .. 0.05 per steradian
  const ParameterLayout layout{3, 3};
  std::size_t linear = 0;
  for (const auto& set : seen.observations.sets)
    for (const auto& channel : set.channels)
      for (const float inverse_sigma : channel.inverse_sigma) linear += inverse_sigma < 0;
  ASSERT_GT(linear, seen.observations.n_values / 4) << "the test must see both kinds";
  ASSERT_LT(linear, seen.observations.n_values);
  expect_gradient_matches(Objective(seen.observations, layout, {.robust_scale = 1e9}), off_truth(layout));
}

/// The table of a rig: footprints, and every channel at a place of its own.
brdf::HalfAngleTable blurred_mosaic() {
  brdf::HalfAngleTable table = table_of(paint("polaris-silber"), 101);
  for (std::size_t c = 0; c < 3; ++c) {
    brdf::TableChannel& t = table.channels[c];
    for (std::size_t i = 0; i < t.mean.size(); ++i) {
      if (t.origin[i] == brdf::CellOrigin::empty) continue;
      if (i % 2) t.phi_d[i] += 0.001f * static_cast<float>(c);  // every second cell is shared
      t.footprint_along[i] = 2e-5f, t.footprint_across[i] = 1e-5f, t.footprint_mixed[i] = 5e-6f;
    }
  }
  return table;
}

TEST(Objective, GradientAndHessianOfABlurredMosaicEqualDifferences) {
  const Observed seen = observed(blurred_mosaic());
  ASSERT_EQ(seen.observations.sets.size(), 4u);
  const ParameterLayout layout{3, 3};
  const Objective objective(seen.observations, layout, {.robust_scale = 1e9});
  std::vector<double> x = off_truth(layout);
  expect_gradient_matches(objective, x);
  expect_curvature_matches(objective, x, fit::Curvature::newton, 1e-5);
}

TEST(Objective, GradientOfGreyLobesAndOfNoDiffusePartEqualsDifferences) {
  const Observed seen = some_observations(0.02, 0.01);
  const ParameterLayout layout{3, fit::Structure{.n_lobes = 3, .diffuse = false, .grey = {true, false, true}}};
  EXPECT_EQ(layout.size(), 1 + 3 + 1 + 6);
  EXPECT_EQ(layout.names()[0], "ks1");
  EXPECT_EQ(layout.names()[1], "ks2.r");
  const Objective objective(seen.observations, layout, {.robust_scale = 1e9});
  expect_gradient_matches(objective, off_truth(layout));
  expect_curvature_matches(objective, off_truth(layout), fit::Curvature::newton, 1e-5);
}

/// Two lobes GGX, two dielectric, one both.
fit::Structure other_forms() {
  fit::Structure structure{.n_lobes = 3};
  structure.distribution[0] = structure.distribution[1] = brdf::Distribution::ggx;
  structure.fresnel[1] = structure.fresnel[2] = brdf::Fresnel::dielectric;
  return structure;
}

TEST(Objective, GradientAndHessianOfGgxAndDielectricLobesEqualDifferences) {
  const ParameterLayout layout{3, other_forms()};
  std::vector<double> x = off_truth(layout);
  x[layout.r(1)] = 0.2, x[layout.r(2)] = 0.05;
  for (const bool blurred : {false, true}) {
    const Observed seen = blurred ? observed(blurred_mosaic()) : some_observations(0.02, 0.01);
    const Objective objective(seen.observations, layout, {.robust_scale = 1e9});
    expect_gradient_matches(objective, x);
    expect_curvature_matches(objective, x, fit::Curvature::newton, 1e-5);
  }
}

void expect_cost_of_the_one_text(const fit::Structure& structure);

TEST(Objective, TheCostIsThatOfTheModelsOneText) {
  expect_cost_of_the_one_text({.n_lobes = 3});
  expect_cost_of_the_one_text(other_forms());
}

void expect_cost_of_the_one_text(const fit::Structure& structure) {
  const Observed seen = observed(blurred_mosaic());
  const ParameterLayout layout{3, structure};
  const brdf::CookTorrance model = layout.unpack(layout.pack(paint("opel-titan")));
  double expected = 0;
  for (const auto& set : seen.observations.sets)
    for (std::size_t k = 0; k < set.size(); ++k)
      for (std::size_t c = 0; c < static_cast<std::size_t>(set.n_channels); ++c) {
        if (set.channels[c].inverse_sigma[k] == 0) continue;  // only another channel is usable there
        const std::size_t channel = static_cast<std::size_t>(set.first_channel) + c;
        const brdf::TableChannel& t = seen.table->channels[channel];
        const std::uint32_t i = set.cell[k];
        auto cosines = brdf::half_angle_cosines(brdf::HalfDiff{t.theta_h[i], t.theta_d[i], t.phi_d[i]});
        cosines.footprint = {t.footprint_along[i], t.footprint_across[i], t.footprint_mixed[i]};
        const double floor = 1e-3 * t.mean[i], f = model.value(cosines)[static_cast<int>(channel)];
        expected += std::pow(std::log((f + floor) / (t.mean[i] + floor)) / 0.01, 2);
      }
  const Objective objective(seen.observations, layout, {.robust_scale = 1e9});
  EXPECT_NEAR(objective.cost(layout.pack(model)), expected, 1e-6 * expected);  // directions are kept as floats
}

TEST(Objective, LoopsWithAndWithoutAvx2GiveTheSameBytes) {
  const Observed seen = observed(with_noise(blurred_mosaic(), 0.05, 0.01, 3));
  const ParameterLayout layout{3, 3};
  const Objective objective(seen.observations, layout, {});
  const std::vector<double> x = off_truth(layout);
  const fit::Quadratic vectors = objective.quadratic(x, fit::Curvature::newton);
  const double cost = objective.cost(x);
  fit::use_vectors(false);
  const fit::Quadratic baseline = objective.quadratic(x, fit::Curvature::newton);
  EXPECT_EQ(objective.cost(x), cost);
  fit::use_vectors(true);
  EXPECT_EQ(vectors.cost, baseline.cost);
  EXPECT_EQ(vectors.gradient, baseline.gradient);
  EXPECT_EQ(vectors.curvature, baseline.curvature);
}

TEST(Objective, GradientOfTheEnergyPenaltyEqualsDifferences) {
  const Observed seen = some_observations(0.02, 0);
  const ParameterLayout layout{3, 3};
  std::vector<double> x = off_truth(layout);
  for (int c = 0; c < 3; ++c) x[layout.kd(c)] = 0.9;  // albedo far above 1
  const Objective without(seen.observations, layout, {.robust_scale = 1e9}),
      with(seen.observations, layout, {.robust_scale = 1e9, .energy_weight = 10});
  ASSERT_GT(with.cost(x), 1.01 * without.cost(x));
  expect_gradient_matches(with, x);
}

TEST(Objective, NewtonCurvatureIsTheHessianAlsoFarFromTheTruth) {
  const Observed seen = some_observations(0.02, 0.01);
  const ParameterLayout layout{3, 3};
  // Without the Huber loss, whose second derivative jumps.
  expect_curvature_matches(Objective(seen.observations, layout, {.robust_scale = 1e9}), off_truth(layout),
                           fit::Curvature::newton, 1e-5);
}

TEST(Objective, GaussNewtonCurvatureIsTheHessianAtASolutionWithoutResiduals) {
  const brdf::CookTorrance truth = paint("ford-f8");
  const Observed seen = observed(table_of(truth, 101));
  const ParameterLayout layout{3, 3};
  expect_curvature_matches(Objective(seen.observations, layout, {}), layout.pack(truth),
                           fit::Curvature::gauss_newton, 1e-4);
}

TEST(Objective, ResidualOfOneCellIsTheLogRatioInSigmas) {
  // By hand: kd = 0.3 is f = 0.3/pi; the cell says 0.1 with a relative error of 3 %, model_sigma 4 %: sigma =
  // 5 %.
  const Observed seen = observed(few_cells({0.1f}, 0.003f), 0.04);
  const Objective objective(seen.observations, {1, 0}, {.robust_scale = 1e9});
  const double bias = 0.03 * 0.03 / 2;  // E[ln(1 + e)] = -var / 2
  const double expected = (std::log(0.3 / std::numbers::pi / 0.1) - bias) / 0.05;
  EXPECT_NEAR(std::sqrt(objective.cost({0.3})), std::abs(expected),
              2e-3 * std::abs(expected));  // the floor of 1e-3 in the logarithm
  // Huber beyond 0.5 sigma: 2 k |r| - k^2.
  const double r = std::sqrt(objective.cost({0.3}));
  EXPECT_NEAR(Objective(seen.observations, {1, 0}, {.robust_scale = 0.5}).cost({0.3}), 2 * 0.5 * r - 0.25, 1e-12);
}

TEST(Objective, WeakAndNegativeCellsAreComparedLinearly) {
  const Observed seen = observed(few_cells({-0.01f, 0.03f}, 0.01f), 1e-6);
  const double f = 0.3 / std::numbers::pi;
  const double expected = std::pow((f + 0.01) / 0.01, 2) + std::pow((f - 0.03) / 0.01, 2);
  EXPECT_NEAR(Objective(seen.observations, {1, 0}, {.robust_scale = 1e9}).cost({0.3}), expected,
              1e-5 * expected);  // float means
}

TEST(Objective, AModelThatUnderflowsHasAFiniteCostAndGradient) {
  const Observed seen = some_observations(0.02, 0);
  const ParameterLayout layout{3, 1};
  brdf::CookTorrance narrow;
  narrow.lobes = {{.ks = {0.1, 0.1, 0.1}, .m = 0.001, .r = 0.5}};
  const fit::Quadratic q = Objective(seen.observations, layout, {}).quadratic(layout.pack(narrow));
  EXPECT_TRUE(std::isfinite(q.cost));
  for (const double g : q.gradient) EXPECT_TRUE(std::isfinite(g));
  for (const double h : q.curvature) EXPECT_TRUE(std::isfinite(h));
  EXPECT_LT(q.gradient[0], 0) << "more diffuse light must help";
}

TEST(Objective, AlbedoEstimateIsTheIntegralOverTheHemisphere) {
  // Reference: the lobe at normal incidence, integrated over wo by the midpoint rule in tan(theta_h), F = r
  // there but for Schlick's rise.
  for (const double m : {0.05, 0.2, 0.4, 0.7, 1.0}) {
    brdf::CookTorrance model;
    model.lobes = {{.ks = {1, 1, 1}, .m = m, .r = 1.0}};  // r = 1: no rise
    double integral = 0;
    constexpr int n = 20000;
    const double top = std::min(1.0, 8 * m);  // tan(theta_h) = 1: wo at the horizon
    for (int i = 0; i < n; ++i) {
      const double t = (i + 0.5) / n * top, theta_o = 2 * std::atan(t);
      if (std::cos(theta_o) <= 0) continue;
      const auto c =
          brdf::half_angle_cosines(brdf::Directions{{0, 0, 1}, {std::sin(theta_o), 0, std::cos(theta_o)}});
      const double d_theta_o = 2 / (1 + t * t) * top / n;
      integral += model.value(c).x * std::cos(theta_o) * 2 * std::numbers::pi * std::sin(theta_o) * d_theta_o;
    }
    EXPECT_NEAR(fit::normal_incidence_albedo(model).x, integral, 0.025 * integral) << "m = " << m;
  }
}

// Cells of one (theta_h, theta_d) that are off together by a normal error of 20 %: that error comes back. Noise alone is none.
TEST(SharedError, IsFoundWhereGroupsAreOffTogetherAndNowhereElse) {
  const brdf::CookTorrance model = paint("polaris-silber");
  brdf::HalfAngleTable table = with_noise(table_of(model, 11), 0.03, 0, 7);
  {
    Observed noise = observed(table, 0.01, brdf::TableGrid::n_cells);
    fit::weigh(noise.observations, 0.01, &model);
    EXPECT_EQ(fit::shared_error(noise.observations, model), 0);
  }
  std::mt19937_64 generator(3);
  std::normal_distribution<double> normal;
  for (auto& channel : table.channels) {
    double off = 1;
    for (std::size_t i = 0; i < brdf::TableGrid::n_cells; ++i) {
      if (i % brdf::TableGrid::n_phi_d == 0) off = std::exp(0.2 * normal(generator));
      channel.mean[i] *= static_cast<float>(off);
    }
  }
  Observed misfit = observed(table, 0.01, brdf::TableGrid::n_cells);
  fit::weigh(misfit.observations, 0.01, &model);
  EXPECT_NEAR(fit::shared_error(misfit.observations, model), 0.2, 0.01);  // some ten thousand groups: 1 % by chance
}

// By hand: two cells of 1 % in one group, shared error 10 %: together 1 / (0.01^2 / 2 + 0.1^2) instead of 2 / 0.01^2.
TEST(SharedError, LimitsWhatAGroupCounts) {
  Observed two = observed(few_cells({0.1f, 0.1f}, 0.0f), 0.01);
  fit::limit_groups(two.observations, 0.1);
  double weight = 0;
  for (const auto& set : two.observations.sets)
    for (const float w : set.channels[0].inverse_sigma) weight += static_cast<double>(w) * w;
  EXPECT_NEAR(weight, 1 / (0.01 * 0.01 / 2 + 0.1 * 0.1), 1e-3);
}

}  // namespace
}  // namespace lacquer::test
