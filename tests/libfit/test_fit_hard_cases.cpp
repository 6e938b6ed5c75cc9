#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "fit_test_support.h"

/// Tables that a rig or a user may well bring and that break careless fits.
namespace lacquer::test {
namespace {

void expect_sane(const fit::FitResult& fit) {
  EXPECT_TRUE(fit.converged) << fit.message;
  for (const fit::Parameter& p : fit.parameters) {
    EXPECT_TRUE(std::isfinite(p.value) && std::isfinite(p.sigma)) << p.name;
    EXPECT_GE(p.value, 0) << p.name;
    if (p.name[0] != 'k') {
      EXPECT_LE(p.value, 1) << p.name;
    }
  }
  for (const double c : fit.covariance) EXPECT_TRUE(std::isfinite(c));
  EXPECT_TRUE(std::isfinite(fit.mean_abs_log));
}

const fit::Parameter& parameter(const fit::FitResult& fit, const std::string& name) {
  for (const fit::Parameter& p : fit.parameters)
    if (p.name == name) return p;
  throw std::runtime_error("no parameter " + name);
}

brdf::CookTorrance one_lobe(double m, double r, const glm::dvec3& kd = {0.02, 0.03, 0.04}) {
  brdf::CookTorrance model = diffuse(kd);
  model.lobes = {{.ks = {0.02, 0.03, 0.025}, .m = m, .r = r}};
  return model;
}

/// Leaves only the cells for which `keep(cell)`.
template <typename Keep>
brdf::HalfAngleTable filtered(brdf::HalfAngleTable table, const Keep& keep) {
  for (auto& channel : table.channels)
    for (std::size_t i = 0; i < channel.origin.size(); ++i)
      if (!keep(brdf::TableGrid::cell(i))) channel.origin[i] = brdf::CellOrigin::empty;
  return table;
}

TEST(HardCases, EveryWidthFromAMirrorToTheRoughest) {
  for (const double m : {0.001, 0.003, 0.01, 0.05, 0.3, 0.7, 1.0}) {
    const brdf::CookTorrance truth = one_lobe(m, 0.5);
    brdf::HalfAngleTable table = table_of(truth, 41);
    if (m < 0.01) table = table_of(truth, 7);  // else the peak falls between the cells
    const fit::FitResult fit = fit::fit_table(table, {.n_lobes = 1, .model_sigma = 1e-4});
    expect_sane(fit);
    EXPECT_NEAR(fit.model.lobes[0].m, m, 1e-5 * m);
    EXPECT_NEAR(fit.model.lobes[0].r, 0.5, 1e-3) << m;
    // At 0.001 the float rounding of the few cells in the peak is larger than the tenth of a sigma that counts as at the bound.
    if (m > 0.001) {
      EXPECT_EQ(parameter(fit, "m1").at_bound, m == 1.0) << m;
    }
  }
}

TEST(HardCases, ReflectanceZeroAndOneAreReportedAtTheirBounds) {
  for (const double r : {0.0, 1.0}) {
    const fit::FitResult fit = fit::fit_table(table_of(one_lobe(0.2, r), 41), {.n_lobes = 1, .model_sigma = 1e-4});
    expect_sane(fit);
    EXPECT_NEAR(fit.model.lobes[0].r, r, 1e-4);
    EXPECT_TRUE(parameter(fit, "r1").at_bound);
    EXPECT_FALSE(parameter(fit, "m1").at_bound);
  }
}

TEST(HardCases, NoDiffusePartSoThatTheModelUnderflows) {
  const fit::FitResult fit = fit::fit_table(filtered(table_of(one_lobe(0.03, 0.4, {0, 0, 0}), 7), [](const auto& c) { return c.theta_h < 45; }),
                                            {.n_lobes = 1, .model_sigma = 1e-4});
  expect_sane(fit);
  EXPECT_NEAR(fit.model.lobes[0].m, 0.03, 1e-5);
  EXPECT_LE(fit.model.kd.x, 1e-6);
}

/// Everything above `level` clipped there, as a sensor does whose shortest exposure is too long.
brdf::HalfAngleTable clipped_at(brdf::HalfAngleTable table, float level) {
  for (auto& channel : table.channels)
    for (std::size_t i = 0; i < channel.mean.size(); ++i)
      if (channel.mean[i] > level) channel.mean[i] = level, channel.origin[i] = brdf::CellOrigin::clipped;
  return table;
}

TEST(HardCases, AClippedPeakIsKnownToBeHigherThanItsBound) {
  // A peak of 3.2 / sr that is seen up to 0.1: bounds are all that is known of its height within 1.2 m of the centre.
  brdf::CookTorrance truth = diffuse({0.02, 0.03, 0.04});
  truth.lobes = {{.ks = glm::dvec3(0.2), .m = 0.1, .r = 0.5}};
  const brdf::HalfAngleTable clipped = clipped_at(with_noise(table_of(truth, 7), 0.05, 0, 3), 0.1f);
  const fit::FitResult fit = fit::fit_table(clipped);
  expect_sane(fit);
  EXPECT_GT(fit.n_bounds, 1000u);
  ASSERT_EQ(fit.model.lobes.size(), 1u);
  for (const char* name : {"ks1.r", "m1", "r1"}) {
    const fit::Parameter* p = nullptr;
    for (const fit::Parameter& candidate : fit.parameters)
      if (candidate.name == name || candidate.name + ".r" == name) p = &candidate;
    ASSERT_TRUE(p) << name;
    EXPECT_NEAR(p->value, name[0] == 'k' ? 0.2 : name[0] == 'm' ? 0.1 : 0.5, 4 * p->sigma) << name;
  }
}

TEST(HardCases, BoundsPullOnlyFromBelow) {
  // Diffuse 0.3 whose bounds of two cells in three lie far below (kept, no effect) or above (raise the fit).
  const brdf::HalfAngleTable table = table_of(diffuse(glm::dvec3(0.3)), 41);
  const auto fitted = [&](float factor) {
    brdf::HalfAngleTable changed = table;
    for (auto& channel : changed.channels)
      for (std::size_t i = 0; i < channel.mean.size(); ++i)
        if (i % 3 != 0 && channel.origin[i] == brdf::CellOrigin::measured) channel.mean[i] *= factor, channel.origin[i] = brdf::CellOrigin::clipped;
    return fit::fit_table(changed, {.n_lobes = 0}).model.kd.x;
  };
  EXPECT_NEAR(fitted(0.5f), 0.3, 1e-6);
  EXPECT_GT(fitted(1.01f), 0.3005);
}

TEST(HardCases, OneRowOfThetaDLeavesTheFresnelTermOpenAndSaysSo) {
  const auto table = filtered(table_of(one_lobe(0.2, 0.5), 1), [](const auto& c) { return c.theta_d == 20; });
  const fit::FitResult fit = fit::fit_table(table, {.n_lobes = 1, .model_sigma = 1e-3});
  expect_sane(fit);
  EXPECT_FALSE(parameter(fit, "r1").determined);
  EXPECT_FALSE(parameter(fit, "ks1.g").determined);
  EXPECT_TRUE(parameter(fit, "m1").determined);
  EXPECT_NEAR(fit.model.lobes[0].m, 0.2, 1e-3);
  EXPECT_LE(fit.mean_abs_log, 1e-4);
}

TEST(HardCases, GrazingCellsOnly) {
  const brdf::CookTorrance truth = one_lobe(0.2, 0.1);
  const auto table = filtered(table_of(truth, 3), [](const auto& c) {
    const auto cosines = brdf::half_angle_cosines(brdf::TableGrid::centre(c));
    return std::max(cosines.n_dot_i, cosines.n_dot_o) < 0.35;
  });
  const fit::FitResult fit = fit::fit_table(table, {.n_lobes = 1, .model_sigma = 1e-4});
  expect_sane(fit);
  EXPECT_NEAR(fit.model.lobes[0].m, 0.2, 1e-3);
}

TEST(HardCases, AConstantTableIsDiffuse) {
  brdf::HalfAngleTable table = table_of(diffuse({0.5, 0.5, 0.5}), 41);
  const fit::FitResult fit = fit::fit_table(table);
  expect_sane(fit);
  EXPECT_EQ(fit.candidates.front().structure, "0 lobes");
  EXPECT_NEAR(fit.model.kd.x, 0.5, 1e-6);
}

TEST(HardCases, NothingButNotANumberIsAnError) {
  brdf::HalfAngleTable table = table_of(diffuse({0.5, 0.5, 0.5}), 41);
  for (auto& channel : table.channels)
    std::fill(channel.mean.begin(), channel.mean.end(), std::numeric_limits<float>::quiet_NaN());
  EXPECT_THROW(fit::fit_table(table), std::exception);
}

TEST(HardCases, WeightsOverTwelveDecades) {
  const brdf::CookTorrance truth = one_lobe(0.2, 0.5);
  brdf::HalfAngleTable table = table_of(truth, 41);
  std::mt19937 generator(7);
  std::normal_distribution<double> normal;
  for (auto& channel : table.channels)
    for (std::size_t i = 0; i < channel.mean.size(); ++i) {
      // Relative errors from 1e-4 to 1e2, i.e. weights from 1e8 to 1e-4.
      const double sigma = channel.mean[i] * std::pow(10.0, -4 + 6 * static_cast<double>(generator() % 1000) / 999);
      channel.variance[i] = static_cast<float>(sigma * sigma);
      channel.mean[i] = static_cast<float>(channel.mean[i] + sigma * normal(generator));
    }
  const fit::FitResult fit = fit::fit_table(table, {.n_lobes = 1, .model_sigma = 1e-5});
  expect_sane(fit);
  EXPECT_NEAR(fit.model.lobes[0].m, 0.2, 1e-4);
  EXPECT_NEAR(fit.model.lobes[0].m, 0.2, 4 * parameter(fit, "m1").sigma);
  EXPECT_NEAR(fit.reduced_chi2, 1, 0.05);
}

TEST(HardCases, AMirrorSeenInAHandfulOfCells) {
  brdf::CookTorrance truth = diffuse({0.01, 0.01, 0.01});
  truth.lobes = {{.ks = {1e-3, 1e-3, 1e-3}, .m = 0.0015, .r = 0.9}};
  const fit::FitResult fit = fit::fit_table(with_noise(table_of(truth, 7), 0.02, 1e-4, 5));
  expect_sane(fit);
  ASSERT_EQ(fit.model.lobes.size(), 1u);
  EXPECT_NEAR(fit.model.lobes[0].m, 0.0015, 0.05 * 0.0015);
}

}  // namespace
}  // namespace lacquer::test
