#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "fit_test_support.h"

namespace lacquer::test {
namespace {

/// Relative error of a float cell value is 6e-8 at most; 1e-5 leaves room for the sum of everything and still
/// says which parameters the data determines: sigma is then what an error of 1e-5 per cell does to the
/// parameter.
fit::FitOptions noise_free() { return {.n_lobes = 3, .max_cells = 30000, .model_sigma = 1e-5}; }

class NoiseFreePaint : public testing::TestWithParam<std::string> {};

TEST_P(NoiseFreePaint, IdentifiableParametersComeBackAndTheFunctionIsRight) {
  const brdf::CookTorrance truth = paint(GetParam());
  const fit::FitResult fit = fit::fit_table(table_of(truth), noise_free());

  EXPECT_TRUE(fit.converged) << fit.message;
  EXPECT_LE(fit.mean_abs_log, 1e-6);  // float rounding of the cells
  EXPECT_LE(mean_abs_log(fit.model, truth), 1e-6);

  if (GetParam() == "2k-acrylack") return;  // two lobes: see the next test
  const std::vector<double> expected = parameter_values(truth);
  ASSERT_EQ(fit.parameters.size(), expected.size());
  int identifiable = 0;
  for (std::size_t k = 0; k < expected.size(); ++k) {
    const fit::Parameter& p = fit.parameters[k];
    if (!p.determined || p.sigma > 2.5e-4 * expected[k]) continue;  // 4 sigma = the 1e-3 that is asked for
    ++identifiable;
    EXPECT_NEAR(p.value, expected[k], 1e-3 * expected[k]) << p.name;
    EXPECT_NEAR(p.value, expected[k], 1e-6 * expected[k] + p.sigma) << p.name;
  }
  // White's first lobe is invisible in red and blue (ks 1e-6 beside kd 0.6) and so weak in green that only m
  // is certain to 1e-3; everything else of every paint is identifiable.
  EXPECT_GE(identifiable, GetParam() == "white" ? 14 : 18);
}

INSTANTIATE_TEST_SUITE_P(Table1, NoiseFreePaint, testing::ValuesIn(paint_names), [](const auto& info) {
  std::string name = info.param;
  std::replace(name.begin(), name.end(), '-', '_');
  return name;
});

TEST(NoiseFree, ALobeThatIsZeroLeavesTheTwoOthersExact) {
  const brdf::CookTorrance truth = paint("2k-acrylack");
  const fit::FitResult fit = fit::fit_table(table_of(truth), noise_free());
  // Lobes are ordered by m, the superfluous one lands anywhere: look the real ones up by m.
  for (std::size_t real : {1u, 2u}) {
    const auto found =
        std::min_element(fit.model.lobes.begin(), fit.model.lobes.end(), [&](const auto& a, const auto& b) {
          const auto distance = [&](const auto& l) {
            return l.ks.x + l.ks.y < 1e-6 ? 1e9 : std::abs(std::log(l.m / truth.lobes[real].m));
          };
          return distance(a) < distance(b);
        });
    EXPECT_NEAR(found->m, truth.lobes[real].m, 1e-3 * found->m);
    EXPECT_NEAR(found->r, truth.lobes[real].r, 1e-3 * found->r);
    for (int c = 0; c < 3; ++c)
      EXPECT_NEAR(found->ks[c], truth.lobes[real].ks[c], 1e-3 * truth.lobes[real].ks[c]);
  }
  const auto undetermined = std::count_if(fit.parameters.begin(), fit.parameters.end(),
                                          [](const auto& p) { return !p.determined; });
  EXPECT_GE(undetermined, 2) << "m and r of the lobe that is not there";
}

TEST(NoiseFree, TwoLobesFitAPaintOfTwoLobesWithoutAnythingUndetermined) {
  brdf::CookTorrance truth = paint("2k-acrylack");
  truth.lobes.erase(truth.lobes.begin());
  fit::FitOptions options = noise_free();
  options.n_lobes = 2;
  const fit::FitResult fit = fit::fit_table(table_of(truth), options);
  const std::vector<double> expected = parameter_values(truth);
  for (std::size_t k = 0; k < expected.size(); ++k) {
    EXPECT_TRUE(fit.parameters[k].determined) << fit.parameters[k].name;
    EXPECT_NEAR(fit.parameters[k].value, expected[k], 1e-5 * expected[k]) << fit.parameters[k].name;
  }
}

TEST(NoiseFree, AllDiffuseTableGivesItsAlbedoWithAnyNumberOfLobes) {
  const brdf::CookTorrance truth = diffuse({0.7, 0.4, 0.05});
  for (const int n_lobes : {0, 1, 3}) {
    fit::FitOptions options = noise_free();
    options.n_lobes = n_lobes;
    options.max_cells = 5000;
    const fit::FitResult fit = fit::fit_table(table_of(truth), options);
    EXPECT_LE(mean_abs_log(fit.model, truth), 1e-6) << n_lobes;
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(fit.model.kd[c], truth.kd[c], 1e-3 * truth.kd[c]) << n_lobes;
  }
}

TEST(NoiseFree, RelativeScaleScalesTheColoursAndNothingElse) {
  const brdf::CookTorrance truth = paint("bmw-339");
  brdf::HalfAngleTable table = table_of(truth);
  table.absolute_scale =
      false;  // else the energy penalty would object to a paint that reflects 4096 times what it gets
  for (auto& channel : table.channels)
    for (float& value : channel.mean)
      value *= 4096;  // a power of two: the table's relative values keep their bits
  const fit::FitResult fit = fit::fit_table(table, noise_free());
  for (std::size_t l = 0; l < 3; ++l) {
    EXPECT_NEAR(fit.model.lobes[l].m, truth.lobes[l].m, 1e-5 * truth.lobes[l].m);
    EXPECT_NEAR(fit.model.lobes[l].ks.y, 4096 * truth.lobes[l].ks.y, 1e-3 * 4096 * truth.lobes[l].ks.y);
  }
  EXPECT_NEAR(fit.model.kd.x, 4096 * truth.kd.x, 1e-4 * 4096 * truth.kd.x);
}

TEST(NoiseFree, OneChannelTableHasOneColour) {
  const brdf::CookTorrance truth = paint("blue-matte");
  brdf::HalfAngleTable table = table_of(truth);
  table.channels = {table.channels[1]};  // green
  const fit::FitResult fit = fit::fit_table(table, noise_free());
  ASSERT_EQ(fit.parameters.size(), 1u + 3 + 2 * 3);
  EXPECT_EQ(fit.parameters[0].name, "kd.y");
  EXPECT_EQ(fit.parameters[3].name, "ks3.y");
  EXPECT_NEAR(fit.model.kd.x, truth.kd.y, 1e-5 * truth.kd.y);
  EXPECT_EQ(fit.model.kd.x, fit.model.kd.z);
  for (std::size_t l = 0; l < 3; ++l) {
    EXPECT_NEAR(fit.model.lobes[l].ks.x, truth.lobes[l].ks.y, 1e-3 * truth.lobes[l].ks.y);
    EXPECT_NEAR(fit.model.lobes[l].m, truth.lobes[l].m, 1e-4 * truth.lobes[l].m);
  }
}

TEST(NoiseFree, AHundredCellsAreEnough) {
  const brdf::CookTorrance truth = paint("polaris-silber");
  // 10 x 10 cells of the grid spread over peak and base, at phi_d = 90 deg where both directions stay above
  // the horizon.
  brdf::HalfAngleTable full = table_of(truth, 1), table(3);
  for (int h = 0; h < 10; ++h)
    for (int d = 0; d < 10; ++d) {
      const std::size_t i = brdf::TableGrid::index(brdf::TableGrid::Cell{2 + 6 * h, 7 * d, 90});
      for (std::size_t c = 0; c < 3; ++c) {
        auto& to = table.channels[c];
        const auto& from = full.channels[c];
        to.mean[i] = from.mean[i], to.origin[i] = from.origin[i], to.theta_h[i] = from.theta_h[i],
        to.theta_d[i] = from.theta_d[i], to.phi_d[i] = from.phi_d[i];
      }
    }
  const fit::FitResult fit = fit::fit_table(table, noise_free());
  EXPECT_EQ(fit.n_cells, 100u);
  EXPECT_LE(mean_abs_log(fit.model, truth), 1e-4);
  for (std::size_t l = 0; l < 3; ++l)
    EXPECT_NEAR(fit.model.lobes[l].m, truth.lobes[l].m, 1e-3 * truth.lobes[l].m);
}

TEST(NoiseFree, CellsAreEvaluatedWhereTheirSamplesWere) {
  // Samples in a corner of each cell: at the centres the fit would be off by percents, at the mean
  // coordinates it is exact.
  const brdf::CookTorrance truth = paint("ford-f8");
  const brdf::CookTorranceBrdf brdf(truth);
  brdf::HalfAngleTable table(3);
  for (std::size_t i = 0; i < brdf::TableGrid::n_cells; i += 29) {
    const auto cell = brdf::TableGrid::cell(i);
    const double low = brdf::TableGrid::theta_h_edge(cell.theta_h),
                 high = brdf::TableGrid::theta_h_edge(cell.theta_h + 1);
    const auto centre = brdf::TableGrid::centre(i);
    for (std::size_t c = 0; c < 3; ++c) {
      // Each channel elsewhere, as with a colour mosaic.
      const auto theta_h = static_cast<float>(low + (0.1 + 0.3 * static_cast<double>(c)) * (high - low));
      const auto theta_d = static_cast<float>(centre.theta_d + 0.004),
                 phi_d = static_cast<float>(centre.phi_d - 0.004);
      const auto d = brdf::directions({theta_h, theta_d, phi_d});
      if (std::min(d.wi.z, d.wo.z) < 0.1) continue;
      auto& t = table.channels[c];
      t.theta_h[i] = theta_h, t.theta_d[i] = theta_d, t.phi_d[i] = phi_d;
      t.mean[i] = static_cast<float>((*brdf.value(d))[static_cast<int>(c)]);
      t.origin[i] = brdf::CellOrigin::measured;
    }
  }
  const fit::FitResult fit = fit::fit_table(table, noise_free());
  const std::vector<double> expected = parameter_values(truth);
  for (std::size_t k = 0; k < expected.size(); ++k)
    EXPECT_NEAR(fit.parameters[k].value, expected[k], 1e-3 * expected[k]);
}

}  // namespace
}  // namespace lacquer::test
