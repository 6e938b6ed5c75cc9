#include "libfit/sample_fit.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "fit_test_support.h"
#include "libbrdf/error.h"
#include "libbrdf/table_accumulator.h"

namespace lacquer::fit {
namespace {

constexpr std::size_t n_views = 24;

/// Samples as a camera makes them: shot noise of 1 to 10 %, a variance that is computed from the noisy value itself,
/// places anywhere within the cells. `tilt`: the calibration believes every half vector that much nearer to the normal's azimuth.
SampleSource camera(const brdf::CookTorrance& paint, std::size_t per_view, double gain = 2e-5, double tilt = 0, double read_noise = 0) {
  SampleSource source{.n_channels = 3, .n_views = n_views, .view = {}};
  source.view = [=](std::size_t view, const SampleSource::Sink& sink) {
    std::mt19937_64 generator(1000 + view);
    std::uniform_real_distribution<double> uniform(0, 1);
    std::normal_distribution<double> normal;
    std::vector<SampleValue> piece;
    for (std::size_t k = 0; k < per_view; ++k) {
      const double u = uniform(generator), angle = uniform(generator), azimuth = uniform(generator);
      SampleValue s{.coordinates = {1.2 * u * u, 1.3 * angle, 3.1 * azimuth}, .footprint = {1e-5, 2e-5, 5e-6}};
      auto cosines = brdf::half_angle_cosines(s.coordinates);
      cosines.footprint = s.footprint;
      if (std::min(cosines.n_dot_i, cosines.n_dot_o) < 0.1) continue;
      s.channel = static_cast<int>(k % 3);
      const double f = paint.value(cosines)[s.channel];
      const double noise = std::sqrt(gain * f + read_noise * read_noise);
      s.value = f + noise * normal(generator);
      s.variance = gain * std::max(s.value, 0.0) + read_noise * read_noise + 1e-12;
      s.coordinates.theta_h += tilt;
      piece.push_back(s);
      if (piece.size() == 1000) sink(piece), piece.clear();
    }
    sink(piece);
  };
  return source;
}

brdf::HalfAngleTable table_of_samples(const SampleSource& source) {
  brdf::TableAccumulator accumulator(3);
  for (std::size_t v = 0; v < source.n_views; ++v)
    source.view(v, [&](std::span<const SampleValue> samples) {
      for (const SampleValue& s : samples) accumulator.add(static_cast<std::size_t>(s.channel), s.coordinates, s.value, s.variance, 1.0, s.footprint);
    });
  return accumulator.table(false);
}

const FitOptions options{.n_lobes = 2, .model_sigma = 1e-3};

TEST(SampleFit, IsWithinItsErrorsOfTheTruthAndOfTheTable) {
  const brdf::CookTorrance truth = test::paint("2k-acrylack");
  const SampleSource source = camera(truth, 12000);
  const FitResult table_fit = fit_table(table_of_samples(source), options), fit = fit_samples(source, table_fit, true);
  EXPECT_TRUE(fit.converged) << fit.message;
  EXPECT_GT(fit.n_residuals, 200000u);
  const std::vector<double> expected = test::parameter_values(fit.model);
  const brdf::CookTorrance ordered = [&] {  // by falling m, the weakest left out
    brdf::CookTorrance model = truth;
    std::erase_if(model.lobes, [](const auto& lobe) { return lobe.ks == glm::dvec3(0); });
    std::stable_sort(model.lobes.begin(), model.lobes.end(), [](const auto& a, const auto& b) { return a.m > b.m; });
    return model;
  }();
  const std::vector<double> true_values = test::parameter_values(ordered);
  ASSERT_EQ(true_values.size(), fit.parameters.size());
  double pulls2 = 0;
  for (std::size_t k = 0; k < true_values.size(); ++k) {
    const Parameter &p = fit.parameters[k], &t = table_fit.parameters[k];
    EXPECT_LT(std::abs(p.value - true_values[k]), 4 * p.sigma) << p.name;
    EXPECT_LT(std::abs(p.value - t.value), 4 * std::max(p.sigma, t.sigma)) << p.name;
    EXPECT_LT(p.sigma, 0.05 * std::max(p.value, 0.02)) << p.name;
    pulls2 += std::pow((p.value - true_values[k]) / p.sigma, 2) / static_cast<double>(true_values.size());
  }
  EXPECT_LT(pulls2, 2.5);
}

TEST(SampleFit, ADiffuseLevelIsNotPulledDownByVariancesMadeOfNoisyValues) {
  const brdf::CookTorrance truth = test::diffuse({0.1, 0.2, 0.3});
  const SampleSource source = camera(truth, 6000, 2e-4, 0, 0.001);
  FitOptions diffuse_only = options;
  diffuse_only.n_lobes = 0;
  const FitResult fit = fit_samples(source, fit_table(table_of_samples(source), diffuse_only), true);
  for (int c = 0; c < 3; ++c) {
    // Weights 1 / variance of the value itself would take the harmonic mean: some 0.2 to 0.6 % less.
    EXPECT_LT(std::abs(fit.model.kd[c] / truth.kd[c] - 1), 0.002) << c;
    EXPECT_LT(std::abs(fit.model.kd[c] - truth.kd[c]), 4 * fit.parameters[static_cast<std::size_t>(c)].sigma) << c;
  }
}

TEST(SampleFit, TheSameBytesForAnyNumberOfThreads) {
  const SampleSource source = camera(test::paint("white"), 2000);
  const FitResult table_fit = fit_table(table_of_samples(source), options);
  const std::string all = fit_to_json(fit_samples(source, table_fit, true), true, "{}");
  const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
  EXPECT_EQ(fit_to_json(fit_samples(source, table_fit, true), true, "{}"), all);
}

TEST(SampleFit, ErrorsOfTheCalibrationAreTheStepThatTheParametersTakeWithIt) {
  const brdf::CookTorrance truth = test::paint("2k-acrylack");
  constexpr double tilt = 2e-5;  // so small that residuals follow it linearly
  const SampleSource source = camera(truth, 6000), tilted = camera(truth, 6000, 2e-5, tilt);
  const FitResult table_fit = fit_table(table_of_samples(source), options);
  const FitResult without = fit_samples(source, table_fit, true), with = fit_samples(source, table_fit, true, {tilted}), moved = fit_samples(tilted, table_fit, true);
  double largest = 0;  // in standard errors
  for (std::size_t k = 0; k < with.parameters.size(); ++k) {
    const Parameter& p = with.parameters[k];
    const double step = std::abs(moved.parameters[k].value - without.parameters[k].value);
    EXPECT_NEAR(p.calibration_sigma, step, 0.1 * step + 0.07 * without.parameters[k].sigma) << p.name;
    EXPECT_NEAR(p.sigma, std::hypot(without.parameters[k].sigma, p.calibration_sigma), 1e-6 * p.sigma) << p.name;
    EXPECT_EQ(p.value, without.parameters[k].value) << p.name;
    largest = std::max(largest, step / without.parameters[k].sigma);
  }
  EXPECT_GT(largest, 1);
}

TEST(SampleFit, TooFewSamplesAreSaid) {
  const SampleSource source = camera(test::paint("white"), 500);
  const FitResult table_fit = fit_table(table_of_samples(source), options);
  SampleSource few = source;
  few.n_views = 1;
  few.view = [&](std::size_t view, const SampleSource::Sink& sink) {
    source.view(view, [&](std::span<const SampleValue> s) { sink(s.first(std::min<std::size_t>(s.size(), 10))); });
  };
  try {
    fit_samples(few, table_fit, true);
    FAIL();
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("too few"), std::string::npos) << e.what();
  }
}

}  // namespace
}  // namespace lacquer::fit
