#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <glm/geometric.hpp>
#include <numbers>
#include <tbb/global_control.h>
#include <vector>

#include "libacquire/sim/noise.h"
#include "libacquire/sim/optics.h"
#include "libacquire/sim/sensor_model.h"
#include "libbrdf/error.h"

namespace lacquer::acquire::sim {
namespace {

struct Moments {
  double mean = 0, variance = 0, skewness = 0;
};

Moments moments(const std::vector<double>& values) {
  Moments m;
  const auto n = static_cast<double>(values.size());
  for (const double v : values) m.mean += v / n;
  double third = 0;
  for (const double v : values) {
    m.variance += (v - m.mean) * (v - m.mean) / (n - 1);
    third += std::pow(v - m.mean, 3) / n;
  }
  m.skewness = third / std::pow(m.variance, 1.5);
  return m;
}

SensorDescription linear_sensor() {
  SensorDescription s;
  s.bits = 12;
  s.black_level_dn = 64;
  s.gain_e_per_dn = 2.5;
  s.read_noise_e = 6;
  s.sensitivity = glm::dvec3(1000);
  return s;
}

SensorDescription noiseless_sensor() {
  SensorDescription s = linear_sensor();
  s.read_noise_e = 0;
  s.gain_e_per_dn = 1e4;  // electrons by the million: shot noise far below one DN
  s.sensitivity = glm::dvec3(1e7);
  return s;
}

RadianceImage uniform_image(int width, int height, int channels, float radiance) {
  RadianceImage image(width, height, channels);
  std::fill(image.data.begin(), image.data.end(), radiance);
  return image;
}

Moments moments_of_frame(const SensorDescription& sensor, float radiance, double exposure, std::uint64_t key = 1) {
  constexpr int width = 400, height = 300;
  const RawFrame frame = SensorModel(sensor, width, height).expose(uniform_image(width, height, 1, radiance), 1, {exposure, 0}, key);
  return moments({frame.data.begin(), frame.data.end()});
}

// ---- random numbers

TEST(Noise, NormalNumbersFollowTheNormalDistribution) {
  constexpr int n = 200000;
  std::vector<double> values;
  for (int i = 0; i < n; ++i) values.push_back(normal(42, static_cast<std::uint64_t>(i)));
  std::sort(values.begin(), values.end());
  double largest = 0;  // Kolmogorov-Smirnov against the error function
  for (int i = 0; i < n; ++i)
    largest = std::max(largest, std::abs(0.5 * std::erfc(-values[static_cast<std::size_t>(i)] / std::numbers::sqrt2) - (i + 0.5) / n));
  EXPECT_LT(largest, 1.95 / std::sqrt(n));  // exceeded by chance in 0.1 % of all keys; the key is fixed
  // Tail beyond the ziggurat's last layer: P(|z| > 3.4426) = 5.76e-4, 115 expected, sigma 11.
  const auto beyond = std::count_if(values.begin(), values.end(), [](double z) { return std::abs(z) > Ziggurat::tail; });
  EXPECT_NEAR(static_cast<double>(beyond), 2e5 * std::erfc(Ziggurat::tail / std::numbers::sqrt2), 40);
}

TEST(Noise, NeighbouringNumbersAndNeighbouringKeysAreUncorrelated) {
  constexpr int n = 100000;
  double index = 0, key = 0;
  for (std::uint64_t i = 0; i < n; ++i) {
    index += normal(7, i) * normal(7, i + 1) / n;
    key += normal(combine(7, 1), i) * normal(combine(7, 2), i) / n;
  }
  EXPECT_NEAR(index, 0, 4 / std::sqrt(n));  // 4 sigma
  EXPECT_NEAR(key, 0, 4 / std::sqrt(n));
}

TEST(Noise, PoissonQuantileInvertsTheDistributionFunction) {
  for (const double mean : {1e-6, 0.02, 0.7, 4.0, 19.5}) {
    double cumulative = 0;
    for (int k = 0; k < 60; ++k) {
      const double probability = std::exp(k * std::log(mean) - mean - std::lgamma(k + 1.0));
      if (probability > 1e-9) {
        EXPECT_EQ(poisson_quantile(mean, cumulative + 0.01 * probability), k) << mean;
        EXPECT_EQ(poisson_quantile(mean, cumulative + 0.99 * probability), k) << mean;
      }
      cumulative += probability;
    }
  }
}

TEST(Noise, ShotNoiseHasThePoissonDistributionsFirstThreeMoments) {
  SensorDescription s = linear_sensor();
  s.read_noise_e = 0;
  const SensorModel sensor(s, 1, 1);
  for (const double mean : {0.3, 5.0, 19.9, 20.1, 60.0, 900.0}) {  // both sides of the change from exact to approximate
    constexpr int n = 200000;
    std::vector<double> electrons;
    for (int i = 0; i < n; ++i) electrons.push_back(sensor.electrons(mean, 3, static_cast<std::uint64_t>(i)));
    const Moments m = moments(electrons);
    EXPECT_NEAR(m.mean, mean, 4 * std::sqrt(mean / n)) << mean;
    EXPECT_NEAR(m.variance / mean, 1, 4 * std::sqrt((2 + 1 / mean) / n) + 1.0 / 18 / mean * (mean > 20)) << mean;
    EXPECT_NEAR(m.skewness, 1 / std::sqrt(mean), 0.03 + 0.1 / mean) << mean;
  }
}

// ---- photon transfer

TEST(Sensor, PhotonTransferCurveGivesGainAndReadNoise) {
  // variance [DN^2] = mean / gain + (read / gain)^2 + 1/12: EMVA 1288, Eq. 10.
  const SensorDescription s = linear_sensor();
  const double constant = std::pow(s.read_noise_e / s.gain_e_per_dn, 2) + 1.0 / 12;
  for (const float radiance : {0.f, 0.02f, 0.2f, 1.f, 4.f, 8.f}) {
    const Moments m = moments_of_frame(s, radiance, 1.0);
    const double signal = static_cast<double>(radiance) * 1000 / s.gain_e_per_dn;
    const double expected = signal / s.gain_e_per_dn + constant;
    EXPECT_NEAR(m.mean, 64 + signal, 4 * std::sqrt(expected / 120000)) << radiance;
    EXPECT_NEAR(m.variance / expected, 1, 4 * std::sqrt(2.0 / 120000)) << radiance;  // 4 sigma of a variance of 120000 values
  }
}

TEST(Sensor, SignalIsLinearInExposureTime) {
  const SensorDescription s = noiseless_sensor();
  const double one = moments_of_frame(s, 0.25f, 1.0).mean - 64, four = moments_of_frame(s, 0.25f, 4.0).mean - 64;
  EXPECT_NEAR(one, 250, 0.1);
  EXPECT_NEAR(four / one, 4, 0.003);  // rounding of 250 to whole DN at most
}

TEST(Sensor, GainMultipliesSignalAndNoiseButNotBlack) {
  SensorDescription s = linear_sensor();
  const SensorModel sensor(s, 400, 300);
  const auto image = uniform_image(400, 300, 1, 0.5f);
  const RawFrame low = sensor.expose(image, 1, {1, 0}, 5), high = sensor.expose(image, 1, {1, 20 * std::log10(4.0)}, 5);
  const Moments a = moments({low.data.begin(), low.data.end()}), b = moments({high.data.begin(), high.data.end()});
  EXPECT_NEAR((b.mean - 64) / (a.mean - 64), 4, 0.01);
  EXPECT_NEAR((b.variance - 1.0 / 12) / (a.variance - 1.0 / 12), 16, 0.2);
}

TEST(Sensor, DarkFrameShowsBlackLevelDarkCurrentAndTheirNoise) {
  SensorDescription s = linear_sensor();
  s.dark_current_e_per_s = 50;
  const Moments m = moments_of_frame(s, 0.f, 2.0);
  EXPECT_NEAR(m.mean, 64 + 100 / 2.5, 0.05);
  EXPECT_NEAR(m.variance, (100 + 36) / 6.25 + 1.0 / 12, 0.4);
}

// ---- limits

TEST(Sensor, ClipsAtTheTopOfTheAdcAndAtZero) {
  SensorDescription s = linear_sensor();
  const RawFrame bright = SensorModel(s, 50, 40).expose(uniform_image(50, 40, 1, 1e6f), 1, {1, 0}, 1);
  EXPECT_TRUE(std::all_of(bright.data.begin(), bright.data.end(), [](auto v) { return v == 4095; }));
  s.black_level_dn = 1;
  const RawFrame dark = SensorModel(s, 50, 40).expose(uniform_image(50, 40, 1, 0.f), 1, {1, 0}, 1);
  EXPECT_EQ(*std::min_element(dark.data.begin(), dark.data.end()), 0);  // read noise of 2.4 DN goes below black, never below 0
  EXPECT_LT(*std::max_element(dark.data.begin(), dark.data.end()), 20);
}

TEST(Sensor, FullWellLimitsTheElectronsAndLeavesOnlyReadNoise) {
  SensorDescription s = linear_sensor();
  s.full_well_e = 5000;
  const Moments m = moments_of_frame(s, 100.f, 1.0);
  EXPECT_NEAR(m.mean, 64 + 5000 / 2.5, 0.05);
  EXPECT_NEAR(m.variance, 36 / 6.25 + 1.0 / 12, 0.1);
  // Exactly at the well half of the shot noise is cut: mean - sigma / sqrt(2 pi).
  const Moments half = moments_of_frame(s, 5.f, 1.0);
  EXPECT_NEAR(half.mean, 64 + (5000 - std::sqrt(5000.0) / std::sqrt(2 * std::numbers::pi)) / 2.5, 0.3);
}

// ---- values that differ

SensorDescription flawed_sensor() {
  SensorDescription s = linear_sensor();
  s.dark_current_e_per_s = 10;
  return s;
}

TEST(Sensor, FlawsHaveTheSpreadAskedForAndAreTheSameForASeed) {
  constexpr int width = 400, height = 300, n = width * height;
  const SensorFlaws flaws{.prnu = 0.02, .dsnu_e = 7, .dark_nonuniformity = 0.5};
  const SensorModel sensor(flawed_sensor(), width, height, flaws, 5), same(flawed_sensor(), width, height, flaws, 5),
      other(flawed_sensor(), width, height, flaws, 6);
  std::vector<double> sensitivity, offset, dark;
  std::size_t equal = 0;
  for (std::size_t i = 0; i < n; ++i) {
    sensitivity.push_back(sensor.relative_sensitivity(i));
    offset.push_back(sensor.offset(i));
    dark.push_back(sensor.dark_current(i));
    ASSERT_EQ(sensor.dark_current(i), same.dark_current(i));
    ASSERT_EQ(sensor.relative_sensitivity(i), same.relative_sensitivity(i));
    equal += sensor.offset(i) == other.offset(i);
  }
  EXPECT_LT(equal, 10u);
  const Moments a = moments(sensitivity), b = moments(offset), c = moments(dark);
  // 4 sigma: of a mean sd / sqrt(n), of a standard deviation sd / sqrt(2 n) (normal).
  EXPECT_NEAR(a.mean, 1, 4 * 0.02 / std::sqrt(n));
  EXPECT_NEAR(std::sqrt(a.variance), 0.02, 4 * 0.02 / std::sqrt(2.0 * n));
  EXPECT_NEAR(b.mean, 0, 4 * 7 / std::sqrt(n));
  EXPECT_NEAR(std::sqrt(b.variance), 7, 4 * 7 / std::sqrt(2.0 * n));
  EXPECT_NEAR(c.mean, 10, 4 * 5 / std::sqrt(n));
  // The log-normal distribution with variance / mean^2 = 0.25 has an excess kurtosis of w^4 + 2 w^3 + 3 w^2 - 6 = 5.0 (w = 1.25).
  EXPECT_NEAR(c.variance / 25, 1, 4 * std::sqrt((2 + 5.0) / n));
  EXPECT_GT(*std::min_element(dark.begin(), dark.end()), 0);
}

TEST(Sensor, HotAndDeadValuesAreAsManyAsAskedForAndStayWhereTheyAre) {
  constexpr int width = 400, height = 300, n = width * height;
  const SensorFlaws flaws{.hot_pixels = 0.01, .dead_pixels = 0.02};
  const SensorModel sensor(flawed_sensor(), width, height, flaws, 5);
  int hot = 0, dead = 0;
  for (std::size_t i = 0; i < n; ++i) {
    const double dark = sensor.dark_current(i);
    EXPECT_TRUE(dark == 10 || (dark >= 3000 && dark <= 30000)) << dark;
    hot += dark > 10;
    dead += sensor.relative_sensitivity(i) == 0;
  }
  EXPECT_NEAR(hot, 0.01 * n, 4 * std::sqrt(0.01 * n));  // binomial
  EXPECT_NEAR(dead, 0.02 * n, 4 * std::sqrt(0.02 * n));
  const RawFrame frame = sensor.expose(uniform_image(width, height, 1, 4.f), 1, {0.5, 0}, 1);
  for (std::size_t i = 0; i < n; ++i) {
    // Electrons expected of this value by hand; 8 sigma of shot and read noise.
    const double electrons = 4 * 1000 * 0.5 * (sensor.relative_sensitivity(i) == 0 ? 0 : 1) + 0.5 * sensor.dark_current(i);
    ASSERT_NEAR(frame.data[i], std::min(64 + electrons / 2.5, 4095.0), 8 * std::sqrt(electrons + 36) / 2.5 + 1) << i;
  }
}

TEST(Sensor, OffsetsAndSensitivitiesShowInTheMeanOfManyFrames) {
  const SensorFlaws flaws{.prnu = 0.05, .dsnu_e = 20};
  const SensorModel sensor(flawed_sensor(), 20, 15, flaws, 5);
  const auto image = uniform_image(20, 15, 1, 2.f);
  constexpr int n_frames = 400;
  std::vector<double> mean(300);
  for (int k = 0; k < n_frames; ++k) {
    const RawFrame frame = sensor.expose(image, 1, {1, 0}, static_cast<std::uint64_t>(k));
    for (std::size_t i = 0; i < 300; ++i) mean[i] += frame.data[i] / static_cast<double>(n_frames);
  }
  for (std::size_t i = 0; i < 300; ++i) {
    const double electrons = 2000 * sensor.relative_sensitivity(i) + 10;
    EXPECT_NEAR(mean[i], 64 + (electrons + sensor.offset(i)) / 2.5, 4.5 * std::sqrt((electrons + 36) / n_frames) / 2.5) << i;
  }
}

TEST(Sensor, FlawsAreReadFromTheRigFile) {
  const std::string rig =
      "[rig]\nname = 'r'\nkind = 'simulated'\n[camera]\nwidth_px = 8\nheight_px = 8\nlayout = 'mono'\nbits = 12\nfocal_length_px = 100\n"
      "position_mm = [0, 0, 1000]\n[sensor]\nsensitivity_e_per_s = 1e5\n[[lights]]\nposition_mm = [0, 0, 600]\n[plan]\nangles_deg = [0]\n"
      "exposures_ms = [1]\n[simulation]\n";
  const SensorFlaws none = parse_rig(rig, "r.toml").simulation.sensor;
  EXPECT_EQ(none.prnu + none.dsnu_e + none.dark_nonuniformity + none.hot_pixels + none.dead_pixels, 0);
  const SensorFlaws flaws =
      parse_rig(rig + "prnu = 0.01\ndsnu_e = 2\ndark_nonuniformity = 0.3\nhot_pixels = 1e-3\ndead_pixels = 1e-4\n", "r.toml").simulation.sensor;
  EXPECT_EQ(flaws.prnu, 0.01);
  EXPECT_EQ(flaws.dsnu_e, 2);
  EXPECT_EQ(flaws.dark_nonuniformity, 0.3);
  EXPECT_EQ(flaws.hot_pixels, 1e-3);
  EXPECT_EQ(flaws.dead_pixels, 1e-4);
  for (const char* bad : {"prnu = -0.1\n", "hot_pixels = 2\n", "dead_pixels = -1\n", "dsnu_e = nan\n", "dark_nonuniformity = -1\n"})
    EXPECT_THROW(parse_rig(rig + bad, "r.toml"), Error) << bad;
}

// ---- response and layout

TEST(Sensor, GammaResponseFollowsItsFormula) {
  SensorDescription s = noiseless_sensor();
  s.response = SensorDescription::Response::gamma;
  s.gamma = 2.2;
  const SensorModel sensor(s, 1, 1);
  std::uint16_t previous = 0;
  for (double x = 0; x < 4031; x += 7.3) {
    const double expected = 64 + 4031 * std::pow(x / 4031, 1 / 2.2);
    EXPECT_NEAR(sensor.value(x), expected, 0.5001);
    EXPECT_GE(sensor.value(x), previous);
    previous = sensor.value(x);
  }
  EXPECT_EQ(sensor.value(4031), 4095);
  EXPECT_EQ(sensor.value(0), 64);
  EXPECT_LT(sensor.value(-1e-6), 65);
}

TEST(Sensor, EveryPixelOfAMosaicShowsItsOwnColour) {
  // Literal layouts by hand, not through channel_of.
  const std::vector<std::pair<PixelLayout, std::string>> mosaics{{PixelLayout::bayer_rggb, "RGGB"}, {PixelLayout::bayer_grbg, "GRBG"},
                                                                 {PixelLayout::bayer_gbrg, "GBRG"}, {PixelLayout::bayer_bggr, "BGGR"}};
  RadianceImage image(6, 4, 3);
  for (int y = 0; y < 4; ++y)
    for (int x = 0; x < 6; ++x)
      for (int c = 0; c < 3; ++c) image.at(c, x, y) = static_cast<float>(0.1 * (c + 1));
  for (const auto& [layout, letters] : mosaics) {
    SensorDescription s = noiseless_sensor();
    s.layout = layout;
    const RawFrame frame = SensorModel(s, 6, 4).expose(image, 1, {1, 0}, 1);
    for (std::size_t y = 0; y < 4; ++y)
      for (std::size_t x = 0; x < 6; ++x) {
        const char letter = letters[(y % 2) * 2 + x % 2];
        EXPECT_NEAR(frame.data[y * 6 + x], 64 + (letter == 'R' ? 100 : letter == 'G' ? 200 : 300), 1) << letters << x << y;
      }
  }
}

TEST(Sensor, RgbIsInterleavedAndHasItsSensitivities) {
  SensorDescription s = noiseless_sensor();
  s.layout = PixelLayout::rgb;
  s.sensitivity = {1e7, 2e7, 3e7};
  const RawFrame frame = SensorModel(s, 2, 2).expose(uniform_image(2, 2, 3, 0.1f), 1, {1, 0}, 1);
  ASSERT_EQ(frame.data.size(), 12u);
  for (std::size_t i = 0; i < 12; ++i) EXPECT_NEAR(frame.data[i], 164 + 100.0 * static_cast<double>(i % 3), 1);
}

TEST(Sensor, EightAndSixteenBitsUseTheirWholeRange) {
  for (const int bits : {8, 16}) {
    SensorDescription s = noiseless_sensor();
    s.bits = bits;
    s.black_level_dn = 0;
    const RawFrame frame = SensorModel(s, 4, 4).expose(uniform_image(4, 4, 1, 1e6f), 1, {1, 0}, 1);
    EXPECT_EQ(frame.bits, bits);
    EXPECT_EQ(frame.data[0], (1 << bits) - 1);
  }
}

TEST(Sensor, FramesDoNotDependOnTheNumberOfThreads) {
  const SensorModel sensor(linear_sensor(), 333, 77);
  const auto image = uniform_image(333, 77, 1, 0.01f);
  const RawFrame parallel = sensor.expose(image, 1, {1, 0}, 9);
  const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
  EXPECT_EQ(sensor.expose(image, 1, {1, 0}, 9).data, parallel.data);
  EXPECT_NE(sensor.expose(image, 1, {1, 0}, 10).data, parallel.data);
}

// ---- lens

TEST(Optics, BlurKeepsEnergyAndHasTheVarianceAskedFor) {
  for (const double sigma : {0.2, 0.5, 1.0, 2.7}) {
    RadianceImage image(61, 61, 1);
    image.at(0, 30, 30) = 1;
    blur(image, sigma);
    double total = 0, variance_x = 0, variance_y = 0;
    for (int y = 0; y < 61; ++y)
      for (int x = 0; x < 61; ++x) {
        const auto v = static_cast<double>(image.at(0, x, y));
        total += v;
        variance_x += v * (x - 30) * (x - 30);
        variance_y += v * (y - 30) * (y - 30);
      }
    EXPECT_NEAR(total, 1, 1e-6);  // float
    EXPECT_NEAR(variance_x, sigma * sigma, 1e-5 * (1 + sigma * sigma));
    EXPECT_NEAR(variance_y, sigma * sigma, 1e-5 * (1 + sigma * sigma));
  }
}

TEST(Optics, BlurOfAUniformImageChangesNothingUpToTheBorder) {
  RadianceImage image = uniform_image(20, 15, 3, 0.7f);
  blur(image, 2.0);
  for (const float v : image.data) EXPECT_NEAR(v, 0.7f, 1e-6);
}

TEST(Optics, StrayLightAddsTheFractionOfTheMeanOfEachChannel) {
  RadianceImage image(10, 10, 3);
  image.at(0, 3, 3) = 100;
  image.at(1, 4, 4) = 200;
  add_stray_light(image, 0.1);
  EXPECT_NEAR(image.at(0, 0, 0), 0.1, 1e-6);
  EXPECT_NEAR(image.at(1, 0, 0), 0.2, 1e-6);
  EXPECT_NEAR(image.at(2, 0, 0), 0.0, 1e-6);
  EXPECT_NEAR(image.at(0, 3, 3), 100.1, 1e-4);
}

TEST(Optics, VignettingIsNothingInTheMiddleAndAllAtTheFarthestCorner) {
  CameraModel camera;
  camera.width = 41;
  camera.height = 31;
  camera.centre = {20, 15};
  RadianceImage image = uniform_image(41, 31, 1, 1.f);
  vignette(image, camera, 0.4);
  EXPECT_NEAR(image.at(0, 20, 15), 1, 1e-7);
  // Pixel (0, 0) is 25 pixels from the centre, the corner of its area sqrt(20.5^2 + 15.5^2).
  EXPECT_NEAR(image.at(0, 0, 0), 1 - 0.4 * 625 / (20.5 * 20.5 + 15.5 * 15.5), 1e-6);
  EXPECT_NEAR(image.at(0, 40, 15), 1 - 0.4 * 400 / (20.5 * 20.5 + 15.5 * 15.5), 1e-6);
}

}  // namespace
}  // namespace lacquer::acquire::sim
