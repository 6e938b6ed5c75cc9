#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "fit_test_support.h"
#include "libbrdf/error.h"
#include "libfit/fitted_model.h"
#include "libfit/residual_map.h"

/// What a fit says of its own errors: profiles, values with errors, maps of residuals; Ceres beside our own solver.
namespace lacquer::test {
namespace {

const fit::Parameter& named(const fit::FitResult& fit, const std::string& name) {
  for (const fit::Parameter& p : fit.parameters)
    if (p.name == name) return p;
  throw std::runtime_error("no parameter " + name);
}

brdf::CookTorrance one_lobe(double ks, double r) {
  brdf::CookTorrance model = diffuse({0.1, 0.2, 0.3});
  model.lobes = {{.ks = glm::dvec3(ks), .m = 0.2, .r = r}};
  return model;
}

TEST(Profile, IsTheStandardErrorWhereTheObjectiveIsABowl) {
  const fit::FitResult fit =
      fit::fit_table(with_noise(table_of(one_lobe(0.1, 0.4), 101), 0.05, 0, 4), {.n_lobes = 1, .model_sigma = 1e-3, .profile = true});
  for (const char* name : {"kd.g", "ks1.r", "m1", "r1"}) {
    const fit::Parameter& p = named(fit, name);
    ASSERT_TRUE(p.profile) << name;
    EXPECT_NEAR((p.profile->high68 - p.value) / p.sigma, 1, 0.06) << name;
    EXPECT_NEAR((p.value - p.profile->low68) / p.sigma, 1, 0.06) << name;
    EXPECT_NEAR((p.profile->high95 - p.profile->low95) / p.sigma, 2 * 1.96, 0.15) << name;
  }
}

TEST(Profile, EndsAtABoundAndIsLopsidedBesideIt) {
  // Hardly any light comes back at normal incidence, and much noise: r may be 0.
  const fit::FitResult fit =
      fit::fit_table(with_noise(table_of(one_lobe(0.02, 0.0001), 1009), 0.2, 0, 8), {.n_lobes = 1, .model_sigma = 1e-3, .profile = true});
  const fit::Parameter& r = named(fit, "r1");
  ASSERT_TRUE(r.determined);
  ASSERT_TRUE(r.profile);
  ASSERT_LT(r.value, 1.95 * r.sigma) << "the error bar alone would reach below 0";
  EXPECT_EQ(r.profile->low95, 0);
  EXPECT_GT(r.profile->high95, std::max(r.value, 0.0001));
}

TEST(Profile, ComesByItselfForTheParameterWhoseErrorReachesItsBound) {
  const fit::FitResult fit = fit::fit_table(with_noise(table_of(one_lobe(0.02, 0.0001), 1009), 0.2, 0, 8), {.n_lobes = 1, .model_sigma = 1e-3});
  EXPECT_TRUE(named(fit, "r1").profile);
  for (const char* name : {"kd.r", "ks1.g", "m1"}) EXPECT_FALSE(named(fit, name).profile) << name;
}

TEST(CalibrationErrors, HalfVectorsThatAreOffWidenTheErrorOfMByWhatTheyBlur) {
  const brdf::HalfAngleTable table = with_noise(table_of(one_lobe(0.02, 0.4), 101), 0.05, 0, 4);
  fit::FitOptions options{.n_lobes = 1, .model_sigma = 1e-3};
  const fit::FitResult sharp = fit::fit_table(table, options);
  options.half_vector_sigma = 0.02;
  const fit::FitResult blurred = fit::fit_table(table, options);
  // A lobe of 0.2 seen through a Gaussian of half vectors of 0.02 in all has m^2 = 0.2^2 + 0.02^2.
  const double expected = std::sqrt(0.04 + 0.0004) - 0.2;
  EXPECT_NEAR(named(blurred, "m1").calibration_sigma, expected, 0.01 * expected);
  EXPECT_NEAR(named(blurred, "m1").sigma, std::hypot(named(sharp, "m1").sigma, expected), 0.01 * expected);
  EXPECT_EQ(named(blurred, "m1").value, named(sharp, "m1").value);
  EXPECT_EQ(named(blurred, "ks1.r").sigma, named(sharp, "ks1.r").sigma);
}

/// Written and read back.
fit::FittedModel stored(const fit::FitResult& fit) {
  TemporaryFolder folder;
  fit::write_fit(folder / "fit.json", fit, true, "{}");
  return fit::read_fit(folder / "fit.json");
}

TEST(ValueSigma, OfADiffusePaintIsThatOfKdOverPi) {
  const fit::FitResult fit = fit::fit_table(with_noise(table_of(diffuse({0.3, 0.4, 0.5}), 101), 0.05, 0, 1), {.n_lobes = 0});
  const glm::dvec3 sigma = fit::value_sigma(stored(fit), brdf::half_angle_cosines(brdf::HalfDiff{0.3, 0.2, 1}));
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(sigma[c], fit.parameters[c].sigma / std::numbers::pi, 1e-9 * sigma[c]);
}

// 60 fits of other noise: the scatter of f at three places is what each of them says of itself.
TEST(ValueSigma, IsTheScatterOfValuesOverRepeats) {
  const brdf::CookTorrance truth = one_lobe(0.1, 0.4);
  const brdf::HalfAngleTable clean = table_of(truth, 1009);
  const brdf::HalfDiff places[] = {{0, 0.3, 0}, {0.2, 0.3, 1}, {0.5, 1, 2}};
  double squares[3] = {};
  constexpr int repeats = 60;
  for (int seed = 1; seed <= repeats; ++seed) {
    const fit::FitResult fit = fit::fit_table(with_noise(clean, 0.05, 0, static_cast<unsigned>(seed)), {.n_lobes = 1, .n_starts = 1, .model_sigma = 1e-3});
    const fit::FittedModel model{fit.model, fit.parameters, fit.covariance};
    for (int k = 0; k < 3; ++k) {
      const auto cosines = brdf::half_angle_cosines(places[k]);
      squares[k] += std::pow((fit.model.value(cosines).y - truth.value(cosines).y) / fit::value_sigma(model, cosines).y, 2) / repeats;
    }
  }
  for (const double s : squares) EXPECT_NEAR(s, 1, 3 * std::sqrt(2.0 / repeats));  // chi^2 / n within 3 sigma
}

TEST(ValueSigma, DrawnModelsScatterAsTheCovarianceSays) {
  const fit::FitResult fit = fit::fit_table(with_noise(table_of(one_lobe(0.1, 0.4), 1009), 0.05, 0, 2), {.n_lobes = 1});
  const fit::FittedModel model{fit.model, fit.parameters, fit.covariance};
  const auto cosines = brdf::half_angle_cosines(brdf::HalfDiff{0.2, 0.3, 1});
  double squares = 0;
  constexpr int n = 400;
  for (const auto& drawn : fit::draw_models(model, n)) squares += std::pow(drawn.value(cosines).y - fit.model.value(cosines).y, 2) / n;
  EXPECT_NEAR(std::sqrt(squares) / fit::value_sigma(model, cosines).y, 1, 0.15);
}

TEST(ReadFit, AModelAloneAndBrokenCovariancesAreNamed) {
  TemporaryFolder folder;
  const auto complaint = [&](const std::string& text) -> std::string {
    write_file(folder / "fit.json", text);
    try {
      fit::read_fit(folder / "fit.json");
    } catch (const Error& e) {
      return e.what();
    }
    return "";
  };
  EXPECT_NE(complaint(R"({"kd": [0, 0, 0], "lobes": []})").find("a model alone has no errors"), std::string::npos);
  const std::string start = R"({"kd": [0, 0, 0], "lobes": [], "parameters": [{"name": ")", end = R"(", "value": 1, "sigma": 1}], "covariance": )";
  EXPECT_NE(complaint(start + "m1" + end + "[[1]]}").find("no parameter 'm1'"), std::string::npos);
  EXPECT_NE(complaint(start + "kd.r" + end + "[[1, 2]]}").find("covariance[0]"), std::string::npos);
  EXPECT_NE(complaint(start + "kd.r" + end + "[]}").find("covariance: expected 1 rows"), std::string::npos);
  EXPECT_EQ(complaint(start + "kd.r" + end + "[[1]]}"), "");
}

TEST(ResidualMap, ShowsWhereAndHowMuchAModelIsOff) {
  const brdf::CookTorrance model = paint("blue-matte");
  brdf::HalfAngleTable table = table_of(model, 7);
  for (auto& channel : table.channels)
    for (std::size_t i = 0; i < channel.mean.size(); ++i)
      if (brdf::TableGrid::cell(i).theta_h == 30) channel.mean[i] *= 1.1f;
  const fit::ResidualMap map = fit::residual_map(table, model);
  for (int h : {10, 30})
    for (int d : {5, 20}) {
      const auto group = static_cast<std::size_t>(h * brdf::TableGrid::n_theta_d + d);
      ASSERT_GT(map.n[group], 0u);
      EXPECT_NEAR(map.mean_log[group], h == 30 ? -std::log(1.1) : 0, 2e-6);  // floats
      EXPECT_NEAR(map.rms_log[group], h == 30 ? std::log(1.1) : 0, 2e-6);
    }
  EXPECT_EQ(map.n.back(), 0u) << "grazing";
}

TEST(CeresSolver, FindsTheSamePaintAsOurOwn) {
  const brdf::HalfAngleTable table = with_noise(table_of(paint("opel-titan"), 101), 0.05, 0, 11);
  fit::FitOptions options{.n_lobes = 3, .n_starts = 2};
  const fit::FitResult own = fit::fit_table(table, options);
  options.ceres = true;
  const fit::FitResult ceres = fit::fit_table(table, options);
  EXPECT_EQ(ceres.message.substr(0, 5), "Ceres");
  EXPECT_TRUE(ceres.converged) << ceres.message;
  for (std::size_t k = 0; k < own.parameters.size(); ++k)
    EXPECT_NEAR(ceres.parameters[k].value, own.parameters[k].value, 0.02 * own.parameters[k].sigma) << own.parameters[k].name;
}

}  // namespace
}  // namespace lacquer::test
