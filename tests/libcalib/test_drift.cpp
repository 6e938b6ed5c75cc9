#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>

#include "libbrdf/error.h"
#include "libcalib/drift.h"
#include "libcalib/drift_fit.h"

namespace lacquer::calib {
namespace {

using Model = LightDrift::Model;

/// A scene seen with shot and read noise: radiance f * s with variance 4 + f * s, s from 0.1 to 3000.
RadianceImage photograph(double f, unsigned seed, int width = 60, int height = 40) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  RadianceImage image{width, height, acquire::PixelLayout::mono, {}, {}, {}};
  for (int i = 0; i < width * height; ++i) {
    const double s = 0.1 * std::pow(3e4, (i % 97) / 96.0), variance = 4 + f * s;
    image.radiance.push_back(static_cast<float>(f * s + std::sqrt(variance) * normal(random)));
    image.variance.push_back(static_cast<float>(4 + std::max(static_cast<double>(image.radiance.back()), 0.0)));
    image.flags.push_back(PixelFlag::valid);
  }
  return image;
}

TEST(IntensityComparison, RatioAndSigmaAreRightOverSeeds) {
  constexpr int n = 300;
  double sum = 0, square = 0;
  for (unsigned seed = 0; seed < n; ++seed) {
    const IntensityComparison comparison(photograph(1, 2 * seed), 0);
    const DriftPoint p = comparison.compare(photograph(0.8, 2 * seed + 1), 10);
    EXPECT_EQ(p.time_s, 10);
    const double z = (p.intensity - 0.8) / std::hypot(p.sigma, 0.8 * comparison.first().sigma);
    sum += z / n, square += z * z / n;
  }
  EXPECT_NEAR(sum, 0, 4 / std::sqrt(n)) << "unbiased: the mean of n standard normal numbers, four sigmas";
  EXPECT_NEAR(std::sqrt(square - sum * sum), 1, 4 / std::sqrt(2.0 * n)) << "standard deviation of n numbers, four sigmas";
}

TEST(IntensityComparison, MovedShadowDoesNotCountAsDrift) {
  const IntensityComparison comparison(photograph(1, 1, 300, 200), 0);
  RadianceImage image = photograph(1.1, 2, 300, 200);
  for (std::size_t i = 0; i < image.radiance.size() / 20; ++i) image.radiance[i] *= 0.1f;  // 5 % of the pixels fall into shadow
  const DriftPoint p = comparison.compare(image, 1);
  // A plain ratio would be 4.5 % low. Four sigmas of 0.04 %, and a tenth of a percent left of the shadow.
  EXPECT_NEAR(p.intensity, 1.1, 0.0028);
}

TEST(IntensityComparison, FlaggedValuesAndThoseOutsideThePatchAreNotLookedAt) {
  RadianceImage first = photograph(1, 1), image = photograph(1, 2);
  for (std::size_t i = 0; i < image.radiance.size(); ++i) {
    const bool inside = i % 60 >= 10 && i % 60 < 40 && i / 60 >= 5 && i / 60 < 25;
    if (!inside) image.radiance[i] = 1e6f;
    if (inside && i % 7 == 0) image.radiance[i] = 1e6f, image.flags[i] = PixelFlag::clipped;
    if (inside && i % 7 == 1) first.radiance[i] = 1e6f, first.flags[i] = PixelFlag::invalid;
  }
  const IntensityComparison comparison(first, 0, PixelRectangle{10, 5, 30, 20});
  const DriftPoint p = comparison.compare(image, 1);
  EXPECT_NEAR(p.intensity, 1, 5 * std::hypot(p.sigma, comparison.first().sigma));
}

TEST(IntensityComparison, WhatCannotBeComparedIsAnError) {
  const RadianceImage image = photograph(1, 1);
  EXPECT_THROW(IntensityComparison(image, 0, PixelRectangle{50, 0, 11, 5}), Error) << "beyond the right edge";
  EXPECT_THROW(IntensityComparison(image, 0, PixelRectangle{0, 0, 0, 5}), Error);
  EXPECT_THROW(IntensityComparison(image, 0, PixelRectangle{2147483647, 0, 2, 5}), Error) << "must not overflow";
  RadianceImage dark = image;
  for (float& r : dark.radiance) r = 0;
  EXPECT_THROW(IntensityComparison(dark, 0), Error);
  EXPECT_THROW(IntensityComparison(image, 0).compare(dark, 1), Error);
  EXPECT_THROW(IntensityComparison(image, 0).compare(photograph(1, 1, 40, 60), 1), Error);
}

/// Intensities `f(t)` with pixel noise `sigma` and flicker `noise`.
template <typename F>
std::vector<DriftPoint> series(int n, double span, const F& f, double sigma, double noise, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  std::vector<DriftPoint> points;
  for (int k = 0; k < n; ++k) {
    const double t = span * k / (n - 1);
    points.push_back({t, f(t) * (1 + noise * normal(random)) + sigma * normal(random), sigma});
  }
  return points;
}

TEST(Drift, SteadyLightIsLeftAloneWhateverItsFlicker) {
  int false_alarms = 0, n = 0;
  for (const double noise : {0.0, 0.002, 0.02})
    for (const int n_points : {2, 5, 8, 30})
      for (unsigned seed = 0; seed < 100; ++seed, ++n) {
        const LightDrift d = fit_drift(series(n_points, 1000, [](double) { return 1.0; }, 0.001, noise, seed));
        false_alarms += d.model != Model::none;
        if (d.model == Model::none) {
          EXPECT_EQ(d.factor(500), 1);
          EXPECT_EQ(d.factor_sigma(500), 0);
        }
      }
  // Three tests at 1 % each, the quarter with two points cannot fail: 2.2 % expected; binomial, four sigmas.
  EXPECT_LT(false_alarms, 0.022 * n + 4 * std::sqrt(0.022 * n));
}

TEST(Drift, ModelsAreToldApart) {
  int linear = 0, warm_up = 0, smooth = 0;
  for (unsigned seed = 0; seed < 40; ++seed) {
    linear += fit_drift(series(20, 1000, [](double t) { return 1 - 1e-4 * t; }, 0.0005, 0.001, seed)).model == Model::linear;
    warm_up += fit_drift(series(20, 1000, [](double t) { return 1 - 0.1 * (1 - std::exp(-t / 200)); }, 0.0005, 0.001, seed)).model == Model::warm_up;
    smooth += fit_drift(series(30, 1000, [](double t) { return 1 + 0.02 * std::sin(t / 120); }, 0.0005, 0.001, seed)).model == Model::smooth;
  }
  EXPECT_GE(linear, 36) << "1 % of each of two tests may prefer a richer model: 39 expected";
  EXPECT_GE(warm_up, 38);
  EXPECT_EQ(smooth, 40);
}

/// Standardised errors of factor(t) over seeds at some times.
template <typename F>
void expect_calibrated(int n_points, double span, const F& f, double sigma, double noise) {
  constexpr int n = 200;
  constexpr std::array<double, 3> fractions{0.15, 0.5, 1.0};
  std::array<double, 3> sum{}, square{};
  for (unsigned seed = 0; seed < n; ++seed) {
    const LightDrift d = fit_drift(series(n_points, span, f, sigma, noise, 1000 + seed));
    for (std::size_t i = 0; i < fractions.size(); ++i) {
      const double t = fractions[i] * span, z = (d.factor(t) - f(t) / f(0)) / d.factor_sigma(t);
      sum[i] += z / n, square[i] += z * z / n;
    }
  }
  for (std::size_t i = 0; i < fractions.size(); ++i) {
    // The light noise is itself estimated from the points, and a time constant is not in sigma: wider than normal by up to a third.
    EXPECT_NEAR(std::sqrt(square[i]), 1.1, 0.25) << "at " << fractions[i] << " of the time";
    EXPECT_LT(std::abs(sum[i]), 0.35) << "bias, in sigmas, at " << fractions[i] << " of the time";
  }
}

TEST(Drift, ErrorBarsOfALinearDriftAreRight) {
  expect_calibrated(12, 2000, [](double t) { return 1 - 3e-5 * t; }, 0.0005, 0.002);
  expect_calibrated(12, 2000, [](double t) { return 1 + 3e-5 * t; }, 0.002, 0);
}

TEST(Drift, ErrorBarsOfAWarmUpAreRight) {
  expect_calibrated(25, 8000, [](double t) { return 1 - 0.15 * (1 - std::exp(-t / 3600)); }, 0.0005, 0.001);
}

TEST(Drift, OrderOfPointsDoesNotMatter) {
  auto points = series(12, 1000, [](double t) { return 1 - 1e-4 * t; }, 0.001, 0.001, 3);
  const LightDrift a = fit_drift(points);
  std::reverse(points.begin(), points.end());
  const LightDrift b = fit_drift(points);
  EXPECT_EQ(a.model, b.model);
  EXPECT_EQ(a.factor(700), b.factor(700));
}

TEST(Drift, BadPointsAreErrors) {
  EXPECT_THROW(fit_drift({{0, 1, 0.1}, {0, 1, 0.1}}), Error) << "one time twice";
  EXPECT_THROW(fit_drift({{0, 1, 0.1}, {1, std::nan(""), 0.1}}), Error);
  EXPECT_THROW(fit_drift({{0, 1, 0}, {1, 1, 0.1}}), Error) << "without sigma";
  EXPECT_THROW(fit_drift({{0, 1, 0.1}, {1, -1, 0.1}}), Error);
  EXPECT_EQ(fit_drift({}).factor(1), 1);
}

TEST(Drift, PatchFollowsEveryViewOnlyWhereItScattersMoreThanItsNoise) {
  int steady = 0;
  for (unsigned seed = 0; seed < 100; ++seed)
    steady += follow_each_view(series(50, 1000, [](double) { return 1.0; }, 0.001, 0, seed)).model == Model::none;
  EXPECT_GE(steady, 95) << "1 % false alarms";
  const auto points = series(50, 1000, [](double t) { return 1 - 1e-4 * t; }, 0.001, 0.01, 1);
  const LightDrift d = follow_each_view(points);
  ASSERT_EQ(d.model, Model::per_view);
  EXPECT_DOUBLE_EQ(d.factor(points[20].time_s) / d.factor(points[10].time_s), points[20].intensity / points[10].intensity);
  EXPECT_GT(d.factor_sigma(points[20].time_s), 0.001) << "its noise and that of the start";
}

TEST(Drift, FlickerOfTheFirstImageOfAPatchDoesNotSetTheScaleOfAll) {
  constexpr int n = 200;
  constexpr double noise = 0.005;
  double square = 0, standardised = 0;
  for (unsigned seed = 0; seed < n; ++seed) {
    auto points = series(50, 1000, [](double t) { return 1 - 1e-4 * t; }, 0.0005, noise, seed);
    const double first = points[0].intensity;
    for (DriftPoint& p : points) p.intensity /= first;
    const LightDrift d = follow_each_view(points);
    ASSERT_EQ(d.model, Model::per_view);
    const double error = first * d.start - 1;  // the true intensity at the start is 1
    square += error * error / n;
    standardised += std::pow(error / d.start_sigma, 2) / n;
  }
  // The end of a line through n points has 2 / sqrt(n) of the scatter of one: 0.28; a third more for a richer model chosen by chance.
  EXPECT_LT(std::sqrt(square), 0.37 * noise);
  EXPECT_NEAR(std::sqrt(standardised), 1, 0.25) << "sigma of 200 numbers 0.05; choosing the model widens it";
}

TEST(Drift, FisherTailMatchesPublishedTables) {
  // Upper 1 % points of F(d1, d2), Abramowitz and Stegun table 26.9.
  EXPECT_NEAR(f_tail(4052.2, 1, 1), 0.01, 1e-6);
  EXPECT_NEAR(f_tail(10.04, 1, 10), 0.01, 2e-5) << "half a unit of the last digit of the table";
  EXPECT_NEAR(f_tail(3.37, 10, 20), 0.01, 3e-5) << "likewise";
  EXPECT_NEAR(f_tail(1.0, 7, 7), 0.5, 1e-12) << "by symmetry";
  EXPECT_NEAR(f_tail(2.0, 2, 6), std::pow(1 + 2.0 / 3, -3), 1e-12) << "closed form for d1 = 2: (1 + 2 f / d2)^(-d2 / 2)";
  EXPECT_EQ(f_tail(0, 3, 5), 1);
}

TEST(Drift, NamesOfModelsRoundTrip) {
  for (const Model m : {Model::none, Model::linear, Model::warm_up, Model::smooth, Model::per_view})
    EXPECT_EQ(drift_model_from_name(name_of(m)), m);
  EXPECT_THROW(drift_model_from_name("cubic"), Error);
}

}  // namespace
}  // namespace lacquer::calib
