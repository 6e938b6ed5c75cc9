#include "libcalib/merge.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <tbb/global_control.h>

#include "libbrdf/error.h"
#include "simulated_bracket.h"

namespace lacquer::calib {
namespace {

using acquire::PixelLayout;
using acquire::RawFrame;
using test::SensorTruth;
using test::expect_same_bytes;
using test::noise_of;
using test::paper_times;

RawFrame frame(int width, int height, double time, std::vector<std::uint16_t> data, int bits = 8) {
  return {width, height, PixelLayout::mono, bits, std::move(data), {time, 0}};
}

/// Error relative to the truth by inverse-variance weighting with the KNOWN noise at the TRUE signal, clipped values left out.
double ideal_value(const std::vector<RawFrame>& frames, const SensorTruth& s, std::size_t i, double radiance) {
  double weighted = 0, precision = 0;
  for (const RawFrame& f : frames) {
    if (f.data[i] == (1 << s.bits) - 1) continue;
    const double t = f.actual.exposure_s, dark = s.dark_current * t / s.gain;
    const double variance = (s.read_noise * s.read_noise + s.dark_current * t) / (s.gain * s.gain) + radiance * t / s.gain + 1.0 / 12;
    weighted += t / variance * (f.data[i] - s.black - dark);
    precision += t * t / variance;
  }
  return weighted / precision;
}

struct Statistics {
  double mean = 0, deviation = 0, rms_error = 0, ideal_rms_error = 0;
};

/// Standardised errors over the pixels whose radiance lies in [low, high).
Statistics statistics(const std::vector<RawFrame>& frames, const SensorTruth& s, const std::vector<double>& radiance,
                      const RadianceImage& image, double low, double high) {
  double n = 0, sum = 0, squares = 0, error = 0, ideal = 0;
  for (std::size_t i = 0; i < radiance.size(); ++i) {
    if (radiance[i] < low || radiance[i] >= high) continue;
    const double difference = image.radiance[i] - radiance[i], z = difference / std::sqrt(image.variance[i]);
    n += 1;
    sum += z;
    squares += z * z;
    error += std::pow(difference / radiance[i], 2);
    ideal += std::pow(ideal_value(frames, s, i, radiance[i]) / radiance[i] - 1, 2);
  }
  const double mean = sum / n;
  return {mean, std::sqrt(squares / n - mean * mean), std::sqrt(error / n), std::sqrt(ideal / n)};
}

std::string error_of(const std::vector<RawFrame>& frames, const Response& response, const NoiseModel& noise = {}) {
  try {
    merge_bracket(frames, response, noise);
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::input);
    return e.what();
  }
  return "no error";
}

// 20000 pixels a decade: the standard error of the mean is 0.007, of the deviation 0.005. The tolerances also hold the skew of z near
// the noise floor, where the reported variance follows the noisy value (first decade: signal to noise down to 3).
TEST(Merge, IsUnbiasedWithTheRightVarianceAndWithinFivePercentOfTheIdealWeightsOverFourDecades) {
  for (const double dark_current : {0.0, 50.0}) {
    SensorTruth s;
    s.dark_current = dark_current;
    const auto radiance = test::log_uniform(80000, 100, 1e6, 1);
    const auto frames = test::simulate_bracket(s, 400, 200, radiance, paper_times(), 2);
    const RadianceImage image = merge_bracket(frames, linear_response(12, 1, s.black), noise_of(s));
    for (double low = 100; low < 1e6; low *= 10) {
      SCOPED_TRACE(testing::Message() << "radiance from " << low << " DN/s, dark current " << dark_current << " e-/s");
      const Statistics z = statistics(frames, s, radiance, image, low, 10 * low);
      EXPECT_NEAR(z.mean, 0, 0.04);
      EXPECT_NEAR(z.deviation, 1, 0.03);
      EXPECT_LT(z.rms_error, 1.05 * z.ideal_rms_error);
    }
  }
}

TEST(Merge, IsUnbiasedThroughACurvedResponse) {
  SensorTruth s;
  s.bits = 10;
  s.black = 0;
  s.gain = 10;
  s.curve = test::gamma_curve(10, 0, 2.2);
  Response response = linear_response(10, 1, 0);
  response.linear = false;
  for (std::size_t v = 0; v < 1024; ++v) response.curves[0].exposure[v] = 512 * std::pow(static_cast<double>(v) / 512, 2.2);
  const auto radiance = test::log_uniform(60000, 1000, 1e6, 3);
  const auto frames = test::simulate_bracket(s, 300, 200, radiance, paper_times(), 4);
  const RadianceImage image = merge_bracket(frames, response, noise_of(s));
  for (double low = 1000; low < 1e6; low *= 10) {
    SCOPED_TRACE(testing::Message() << "radiance from " << low);
    double n = 0, sum = 0, squares = 0;
    for (std::size_t i = 0; i < radiance.size(); ++i) {
      if (radiance[i] < low || radiance[i] >= 10 * low) continue;
      const double z = (image.radiance[i] - radiance[i]) / std::sqrt(image.variance[i]);
      n += 1, sum += z, squares += z * z;
    }
    EXPECT_NEAR(sum / n, 0, 0.03);
    EXPECT_NEAR(std::sqrt(squares / n), 1, 0.03);
  }
}

// Just around the clipping threshold of the longest exposure, where leaving out clipped values alone would keep only negative noise
// (a bias of up to 0.4 sigma); the standard error of the mean is 0.01.
TEST(Merge, IsUnbiasedAtTheClippingThreshold) {
  const SensorTruth s;
  const std::vector<double> radiance(10000, (4095 - 64) / 0.328);
  const auto frames = test::simulate_bracket(s, 100, 100, radiance, paper_times(), 5);
  const RadianceImage image = merge_bracket(frames, linear_response(12, 1, s.black), noise_of(s));
  double sum = 0;
  for (std::size_t i = 0; i < radiance.size(); ++i) sum += (image.radiance[i] - radiance[i]) / std::sqrt(image.variance[i]);
  EXPECT_NEAR(sum / 10000, 0, 0.04);
}

// By hand: 8 bit, gain 1, read noise 0; values 50 at 1 s and 120 at 2 s. Prediction (50 + 120) / 3 s = 56.667 DN/s; variances
// 56.667 + 1/12 = 56.75 and 113.333 + 1/12 = 113.41667; precision 1/56.75 + 4/113.41667 = 0.0528894;
// value (50/56.75 + 2*120/113.41667) / 0.0528894 = 56.6695.
TEST(Merge, WeighsTwoExposuresAsComputedByHand) {
  NoiseModel noise;
  noise.read_noise_e = 0;
  const RadianceImage image = merge_bracket(std::vector{frame(1, 1, 1, {50}), frame(1, 1, 2, {120})}, linear_response(8, 1, 0), noise);
  const double p1 = 1 / 56.75, p2 = 4 / 113.416667;
  EXPECT_NEAR(image.radiance[0], (p1 * 50 + p2 * 60) / (p1 + p2), 1e-4);
  EXPECT_NEAR(image.variance[0], 1 / (p1 + p2), 1e-3);  // 5e-5: the variance is a straight line within a quarter octave of radiance
  EXPECT_EQ(image.flags[0], PixelFlag::valid);
}

TEST(Merge, OrderOfFramesThreadsAndDuplicatesDoNotChangeAByte) {
  SensorTruth s;
  s.layout = PixelLayout::rgb;
  auto times = paper_times();
  times.push_back(times[3]);
  times.push_back(times[9]);
  const auto radiance = test::log_uniform(37 * 23 * 3, 10, 1e7, 6);
  auto frames = test::simulate_bracket(s, 37, 23, radiance, times, 7);
  const Response response = linear_response(12, 3, s.black);
  const RadianceImage first = merge_bracket(frames, response, noise_of(s));
  std::shuffle(frames.begin(), frames.end(), std::mt19937_64(8));
  expect_same_bytes(first, merge_bracket(frames, response, noise_of(s)));
  const tbb::global_control one_thread(tbb::global_control::max_allowed_parallelism, 1);
  expect_same_bytes(first, merge_bracket(frames, response, noise_of(s)));
}

TEST(Merge, AValueClippedInAllFramesIsTheLargestLowerBound) {
  // Rounding gives 255 from 254.5 on; the shortest exposure, 0.5 s, bounds best: 509 DN/s.
  const RadianceImage image =
      merge_bracket(std::vector{frame(1, 1, 2, {255}), frame(1, 1, 0.5, {255}), frame(1, 1, 1, {255})}, linear_response(8, 1, 0), {});
  EXPECT_EQ(image.flags[0], PixelFlag::clipped);
  EXPECT_FLOAT_EQ(image.radiance[0], 509);
  EXPECT_FLOAT_EQ(image.variance[0], (4 + 254.5f + 1.0f / 12) / 0.25f);  // read noise 2 e-, gain 1
}

TEST(Merge, AFullWellBelowTheRangeClipsThere) {
  NoiseModel noise;
  noise.saturation_dn = 200;
  const auto image = merge_bracket(std::vector{frame(2, 1, 1, {199, 200})}, linear_response(8, 1, 0), noise);
  EXPECT_EQ(image.flags[0], PixelFlag::valid);
  EXPECT_EQ(image.flags[1], PixelFlag::clipped);
}

TEST(Merge, ADarkValueKeepsItsSignAndVariance) {
  NoiseModel noise;
  noise.black_level_dn = 16;
  const auto image = merge_bracket(std::vector{frame(2, 1, 1, {13, 16}), frame(2, 1, 1, {15, 16})}, linear_response(8, 1, 16), noise);
  EXPECT_EQ(image.flags[0], PixelFlag::dark);
  EXPECT_FLOAT_EQ(image.radiance[0], -2);
  EXPECT_NEAR(image.variance[0], (4 + 1.0 / 12) / 2, 1e-5);
  EXPECT_EQ(image.flags[1], PixelFlag::dark);
  EXPECT_FLOAT_EQ(image.radiance[1], 0);
}

TEST(Merge, AllZeroFramesWithoutBlackLevelAreDarkNotClipped) {
  const auto image = merge_bracket(std::vector{frame(1, 1, 1, {0}), frame(1, 1, 4, {0})}, linear_response(8, 1, 0), {});
  EXPECT_EQ(image.flags[0], PixelFlag::dark);
  EXPECT_FLOAT_EQ(image.radiance[0], 0);
  EXPECT_GT(image.variance[0], 0);
}

// 0 in a short frame and clipped in one 1000 times longer: only the bounds are known. The long one says at least 254.5 / 1 s.
TEST(Merge, AValueBetweenFloorAndSaturationLiesBetweenItsBounds) {
  const auto image = merge_bracket(std::vector{frame(1, 1, 0.001, {0}), frame(1, 1, 1, {255})}, linear_response(8, 1, 0), {});
  EXPECT_GE(image.radiance[0], 254.5f);
  EXPECT_LT(image.radiance[0], 2000 + 254.5f);  // 0 +- 2 DN in a millisecond
  EXPECT_TRUE(std::isfinite(image.variance[0]));
}

// A pure-blue border of a registered photograph: clipped where the other exposures say 25 DN.
TEST(Merge, AClippedValueThatContradictsTheOthersIsLeftOut) {
  NoiseModel noise;
  noise.black_level_dn = 0;
  const auto clean = merge_bracket(std::vector{frame(1, 1, 1, {50}), frame(1, 1, 2, {100})}, linear_response(8, 1, 0), noise);
  const auto torn = merge_bracket(std::vector{frame(1, 1, 1, {50}), frame(1, 1, 2, {100}), frame(1, 1, 0.5, {255})},
                                  linear_response(8, 1, 0), noise);
  EXPECT_NEAR(torn.radiance[0], clean.radiance[0], 0.01);
}

TEST(Merge, MosaicAndRgbUseTheCurveOfTheirChannel) {
  Response response = linear_response(8, 3, 0);
  response.linear = false;
  for (std::size_t c = 0; c < 3; ++c)
    for (double& e : response.curves[c].exposure) e *= static_cast<double>(c + 1);
  RawFrame rgb = frame(1, 1, 1, {100, 100, 100});
  rgb.layout = PixelLayout::rgb;
  const auto from_rgb = merge_bracket(std::vector{rgb}, response, {});
  for (std::size_t c = 0; c < 3; ++c) EXPECT_FLOAT_EQ(from_rgb.radiance[c], 100.0f * static_cast<float>(c + 1));
  RawFrame mosaic = frame(3, 3, 1, std::vector<std::uint16_t>(9, 100));
  mosaic.layout = PixelLayout::bayer_grbg;
  const auto from_mosaic = merge_bracket(std::vector{mosaic}, response, {});
  // G R G / B G B / G R G
  const float expected[] = {200, 100, 200, 300, 200, 300, 200, 100, 200};
  for (std::size_t i = 0; i < 9; ++i) EXPECT_FLOAT_EQ(from_mosaic.radiance[i], expected[i]) << i;
}

TEST(Merge, SingleRowsColumnsAndSizesAcrossATileAgreeWithPixelByPixel) {
  const SensorTruth s;
  const Response response = linear_response(12, 1, s.black);
  for (const auto& [width, height] : {std::pair{1, 1}, {1, 700}, {700, 1}, {257, 3}, {256, 2}}) {
    const auto radiance = test::log_uniform(static_cast<std::size_t>(width * height), 100, 1e6, 9);
    const auto frames = test::simulate_bracket(s, width, height, radiance, {0.001, 0.01, 0.1}, 10);
    const RadianceImage image = merge_bracket(frames, response, noise_of(s));
    for (const std::size_t i : {std::size_t{0}, radiance.size() / 2, radiance.size() - 1}) {
      std::vector<RawFrame> pixel;
      for (const RawFrame& f : frames) pixel.push_back(frame(1, 1, f.actual.exposure_s, {f.data[i]}, 12));
      EXPECT_EQ(merge_bracket(pixel, response, noise_of(s)).radiance[0], image.radiance[i]) << width << " x " << height;
    }
  }
}

TEST(Merge, ExposuresOverSixDecadesStayFiniteAndRight) {
  const SensorTruth s;
  const auto radiance = test::log_uniform(2000, 1, 3e7, 11);
  const auto frames = test::simulate_bracket(s, 50, 40, radiance, test::time_series(1e-4, 10, 7), 12);
  const RadianceImage image = merge_bracket(frames, linear_response(12, 1, s.black), noise_of(s));
  for (std::size_t i = 0; i < radiance.size(); ++i)
    EXPECT_LT(std::abs(image.radiance[i] - radiance[i]), 5 * std::sqrt(image.variance[i])) << radiance[i];  // 5 sigma of 2000
}

TEST(Merge, RefusesFramesThatDifferAndNamesThem) {
  const Response r = linear_response(8, 1, 0);
  const RawFrame good = frame(2, 1, 1, {1, 2});
  EXPECT_EQ(error_of({}, r), "bracket: expected at least one frame, got none");
  EXPECT_EQ(error_of({good, frame(1, 2, 1, {1, 2})}, r), "frame 2 of 2: size: expected 2 x 1 as in frame 1, got 1 x 2");
  EXPECT_EQ(error_of({good, good, frame(2, 1, 1, {1, 2}, 10)}, r), "frame 3 of 3: bits: expected 8 as in frame 1, got 10");
  EXPECT_EQ(error_of({good, frame(2, 1, 1, {1})}, r), "frame 2 of 2: data: expected 2 values, got 1");
  EXPECT_EQ(error_of({frame(2, 1, 1, {1, 256})}, r), "frame 1 of 1: value 256: expected less than 2^8 = 256");
  for (const double t : {0.0, -1.0, double(NAN), double(INFINITY)})
    EXPECT_NE(error_of({good, frame(2, 1, t, {1, 2})}, r).find("frame 2 of 2: exposure: expected a number of seconds"), std::string::npos);
  RawFrame gained = good;
  gained.actual.gain_db = 6;
  EXPECT_NE(error_of({good, gained}, r).find("frame 2 of 2: gain: expected 0 dB"), std::string::npos);
  RawFrame mosaic = good;
  mosaic.layout = PixelLayout::bayer_rggb;
  EXPECT_EQ(error_of({good, mosaic}, r), "frame 2 of 2: layout: expected mono as in frame 1, got rggb");
}

TEST(Merge, RefusesAResponseOrNoiseModelThatDoesNotFit) {
  const std::vector<RawFrame> frames{frame(2, 1, 1, {1, 2})};
  EXPECT_EQ(error_of(frames, linear_response(10, 1, 0)), "response: bits: expected 8 as the frames have, got 10");
  EXPECT_EQ(error_of(frames, linear_response(8, 3, 0)), "response: curves: expected 1 for layout mono, got 3");
  Response flat = linear_response(8, 1, 0);
  flat.curves[0].exposure[7] = flat.curves[0].exposure[6];
  EXPECT_EQ(error_of(frames, flat), "response: curve: expected finite, strictly increasing values, entry 7 is not");
  NoiseModel noise;
  noise.gain_e_per_dn = NAN;
  EXPECT_NE(error_of(frames, linear_response(8, 1, 0), noise).find("noise model: gain_e_per_dn"), std::string::npos);
}

}  // namespace
}  // namespace lacquer::calib
