#include <gtest/gtest.h>

#include <cmath>

#include "fit_test_support.h"

namespace lacquer::test {
namespace {

TEST(Noise, FivePercentOnFortyThousandCellsRecoversEveryParameterWithinOnePercentAndFourSigma) {
  const brdf::CookTorrance truth = paint("ford-f8");
  const brdf::HalfAngleTable table = with_noise(table_of(truth, 13), 0.05, 0, 1);
  const fit::FitResult fit = fit::fit_table(table, {.n_lobes = 3, .max_cells = 40000, .model_sigma = 1e-3});
  EXPECT_TRUE(fit.converged) << fit.message;
  EXPECT_LE(fit.n_cells, 40000u);
  EXPECT_GE(fit.n_cells, 39000u);
  const std::vector<double> expected = parameter_values(truth);
  for (std::size_t k = 0; k < expected.size(); ++k) {
    const fit::Parameter& p = fit.parameters[k];
    EXPECT_NEAR(p.value, expected[k], 0.01 * expected[k])
        << p.name;  // what SciPy's least_squares reaches on such a table
    EXPECT_NEAR(p.value, expected[k], 4 * p.sigma) << p.name;
    EXPECT_TRUE(p.determined) << p.name;
  }
  EXPECT_NEAR(fit.reduced_chi2, 1, 0.03);
  EXPECT_NEAR(fit.mean_abs_log, 0.05 * std::sqrt(2 / 3.14159265),
              0.002);  // mean |e| of a normal distribution
}

TEST(Noise, ReportedErrorsMatchTheScatterOfManyRepeats) {
  const brdf::CookTorrance truth = paint("ford-f8");  // no parameter at a bound
  const brdf::HalfAngleTable clean = table_of(truth, 101, 1);
  const std::vector<double> expected{
      truth.kd.x,       truth.lobes[0].ks.x, truth.lobes[1].ks.x, truth.lobes[2].ks.x, truth.lobes[0].m,
      truth.lobes[0].r, truth.lobes[1].m,    truth.lobes[1].r,    truth.lobes[2].m,    truth.lobes[2].r};
  constexpr int repeats = 40;
  std::vector<double> sum(expected.size()), squares(expected.size());
  for (unsigned seed = 1; seed <= repeats; ++seed) {
    // 3 % and a floor of a third of the diffuse part: many cells away from the highlight drown in noise.
    const fit::FitResult fit =
        fit::fit_table(with_noise(clean, 0.03, 1e-4, seed), {.n_lobes = 3, .n_starts = 2, .model_sigma = 1e-4});
    for (std::size_t k = 0; k < expected.size(); ++k) {
      const fit::Parameter& p = fit.parameters[k];
      ASSERT_TRUE(p.determined && !p.at_bound) << p.name;
      const double pull = (p.value - expected[k]) / p.sigma;
      sum[k] += pull, squares[k] += pull * pull;
    }
  }
  for (std::size_t k = 0; k < expected.size(); ++k) {
    const double mean = sum[k] / repeats, deviation = std::sqrt(squares[k] / repeats - mean * mean);
    // Of 40 normal pulls the standard deviation's own error is 0.11, the mean's 0.16: three of these.
    EXPECT_NEAR(deviation, 1, 0.33) << "parameter " << k;
    EXPECT_NEAR(mean, 0, 0.48) << "parameter " << k;
  }
}

TEST(Noise, AFifthOfOutliersMovesNothingByMoreThanAFewPercent) {
  const brdf::CookTorrance truth = paint("polaris-silber");
  brdf::HalfAngleTable table = with_noise(table_of(truth), 0.02, 0, 3);
  std::mt19937 generator(4);
  for (auto& channel : table.channels)
    for (std::size_t i = 0; i < channel.mean.size(); ++i)
      if (generator() % 5 == 0) channel.mean[i] *= generator() % 2 ? 30.0f : 0.02f;
  const fit::FitResult fit = fit::fit_table(table, {.n_lobes = 3, .max_cells = 20000});
  EXPECT_LE(mean_abs_log(fit.model, truth), 0.03);
  for (std::size_t l = 0; l < 3; ++l)
    EXPECT_NEAR(fit.model.lobes[l].m, truth.lobes[l].m, 0.05 * truth.lobes[l].m);
}

TEST(Noise, DarkCellsDoNotBiasTheDiffusePart) {
  // Diffuse paint whose every cell has a signal of twice its noise, a few of them negative. A fit in pure
  // logarithms would be off by 10 % and could not use the negative cells at all.
  const brdf::CookTorrance truth = diffuse({0.02, 0.02, 0.02});
  const brdf::HalfAngleTable table = with_noise(table_of(truth), 0, 0.02 / 3.14159265 / 2, 8);
  const fit::FitResult fit = fit::fit_table(table, {.n_lobes = 0, .max_cells = 20000, .model_sigma = 1e-3});
  EXPECT_EQ(fit.left_out.not_positive, 0u);
  for (int c = 0; c < 3; ++c) {
    EXPECT_NEAR(fit.model.kd[c], 0.02, 4 * fit.parameters[static_cast<std::size_t>(c)].sigma);
    EXPECT_LE(fit.parameters[static_cast<std::size_t>(c)].sigma, 1e-4);  // 1/2 of the value / sqrt(20000)
  }
}

TEST(Noise, AThirdLobeOnAPaintOfOneLobeStaysSane) {
  brdf::CookTorrance truth = diffuse({0.1, 0.2, 0.3});
  truth.lobes = {{.ks = {0.05, 0.05, 0.05}, .m = 0.2, .r = 0.3}};
  const brdf::HalfAngleTable table = with_noise(table_of(truth), 0.03, 0, 6);
  const fit::FitResult fit = fit::fit_table(table, {.n_lobes = 3, .max_cells = 10000});
  EXPECT_LE(mean_abs_log(fit.model, truth),
            0.01);  // 0.03 / sqrt(10000 / 18) = 0.0013, with room for correlated parameters
  for (const fit::Parameter& p : fit.parameters) {
    EXPECT_TRUE(std::isfinite(p.value) && std::isfinite(p.sigma)) << p.name;
    EXPECT_GE(p.value, 0) << p.name;
    if (p.name[0] != 'k') {
      EXPECT_LE(p.value, 1) << p.name;
    }
  }
}

}  // namespace
}  // namespace lacquer::test
