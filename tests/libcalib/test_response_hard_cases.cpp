#include <cmath>
#include <tbb/global_control.h>

#include "libbrdf/error.h"
#include "libcalib/bracket_samples.h"
#include "libcalib/response.h"
#include "simulated_bracket.h"
#include "test_support.h"

namespace lacquer::calib {
namespace {

using acquire::PixelLayout;
using acquire::RawFrame;
using test::SensorTruth;

using Brackets = std::vector<std::vector<RawFrame>>;

ResponseEstimate estimate(const std::vector<RawFrame>& frames, double black = 0) {
  ResponseOptions options;
  options.black_level_dn = black;
  return estimate_response(Brackets{frames}, options);
}

std::string error_of(const std::vector<RawFrame>& frames) {
  try {
    estimate(frames);
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::input);
    EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos);
    return e.what();
  }
  return "no error";
}

void expect_sound(const Response& response) {
  const auto mid = std::size_t{1} << (response.bits - 1);
  for (const ResponseCurve& curve : response.curves) {
    ASSERT_EQ(curve.exposure.size(), 2 * mid);
    for (std::size_t v = 0; v < curve.exposure.size(); ++v) {
      ASSERT_TRUE(std::isfinite(curve.exposure[v])) << v;
      if (v == 0) continue;
      ASSERT_GT(curve.exposure[v], curve.exposure[v - 1]) << v;
    }
    for (const double sigma : curve.band_log_sigma) ASSERT_TRUE(std::isfinite(sigma) && sigma >= 0);
  }
}

/// Gamma 1.8, some noise. Radiances cover the range for times of about 1 to 100 ms.
SensorTruth gamma_sensor(int bits) {
  SensorTruth s;
  s.bits = bits, s.black = 0, s.gain = 20000 / std::exp2(bits), s.read_noise = 6;
  s.curve = test::gamma_curve(bits, 0, 1.8);
  return s;
}

double rms_error(const ResponseCurve& curve, int bits, double low, double high) {
  const double range = std::exp2(bits), mid = range / 2;
  double sum = 0, n = 0;
  for (double v = std::ceil(low * range); v <= high * range; ++v, ++n)
    sum += std::pow(std::log(curve.exposure[static_cast<std::size_t>(v)] / (mid * std::pow(v / mid, 1.8))), 2);
  return std::sqrt(sum / n);
}

TEST(ResponseHardCases, OneFrameIsRefused) {
  const RawFrame f{2, 1, PixelLayout::mono, 8, {100, 120}, {0.5, 0}};
  EXPECT_NE(error_of({f}).find("expected frames with different exposure times"), std::string::npos);
}

TEST(ResponseHardCases, MixedSizesAreRefusedNamingTheFrame) {
  const RawFrame f{2, 1, PixelLayout::mono, 8, {100, 120}, {0.5, 0}};
  RawFrame g{1, 1, PixelLayout::mono, 8, {100}, {1, 0}};
  EXPECT_NE(error_of({f, g}).find("frame 2 of 2: size: expected 2 x 1 as in frame 1, got 1 x 1"), std::string::npos);
}

TEST(ResponseHardCases, OnePixelTwoFramesGivesSomethingFinite) {
  expect_sound(estimate({{1, 1, PixelLayout::mono, 8, {50}, {1, 0}}, {1, 1, PixelLayout::mono, 8, {100}, {2, 0}}}).response);
}

TEST(ResponseHardCases, TwoLevelImage) {
  std::vector<std::uint16_t> a(400, 40), b(400, 80);
  std::fill(a.begin() + 200, a.end(), std::uint16_t{100});
  std::fill(b.begin() + 200, b.end(), std::uint16_t{200});
  const auto result = estimate({{20, 20, PixelLayout::mono, 8, a, {1, 0}}, {20, 20, PixelLayout::mono, 8, b, {2, 0}}});
  expect_sound(result.response);
  EXPECT_NEAR(result.response.curves[0].exposure[200] / result.response.curves[0].exposure[100], 2, 0.05);
}

TEST(ResponseHardCases, DuplicateExposuresAddInformationAndNothingElse) {
  const SensorTruth s = gamma_sensor(10);
  const auto radiance = test::log_uniform(10000, 2e3, 2e6, 1);
  const auto once = test::simulate_bracket(s, 100, 100, radiance, {0.001, 0.002, 0.004, 0.008, 0.016, 0.032}, 2);
  const auto twice = test::simulate_bracket(s, 100, 100, radiance, {0.001, 0.001, 0.002, 0.002, 0.004, 0.004, 0.008, 0.008, 0.016, 0.016, 0.032, 0.032}, 3);
  const auto a = estimate(once), b = estimate(twice);
  expect_sound(b.response);
  EXPECT_LT(rms_error(b.response.curves[0], 10, 0.1, 0.95), 0.005);
  EXPECT_LT(*log_sigma_at(b.response.curves[0], 800), 1.05 * *log_sigma_at(a.response.curves[0], 800));
  for (const double e : b.log_time_correction) EXPECT_LT(std::abs(e), 0.003);
}

// Every frame the same picture whatever its time: no sensor does that, and no power law is a sensible start.
TEST(ResponseHardCases, FramesThatGetDarkerWithTimeGiveAFiniteCurve) {
  std::vector<std::uint16_t> bright(100), dark(100);
  for (std::size_t i = 0; i < 100; ++i) bright[i] = static_cast<std::uint16_t>(100 + i), dark[i] = static_cast<std::uint16_t>(50 + i / 2);
  expect_sound(estimate({{10, 10, PixelLayout::mono, 8, bright, {1, 0}}, {10, 10, PixelLayout::mono, 8, dark, {2, 0}},
                         {10, 10, PixelLayout::mono, 8, dark, {4, 0}}}).response);
}

TEST(ResponseHardCases, OddSizesAndSingleRows) {
  const SensorTruth s = gamma_sensor(12);
  const auto times = test::time_series(0.001, 2, 7);
  for (const auto& [width, height] : {std::pair{4001, 1}, std::pair{1, 4001}, std::pair{61, 67}}) {
    const auto radiance = test::log_uniform(static_cast<std::size_t>(width * height), 1e4, 1e7, 4);
    const auto result = estimate(test::simulate_bracket(s, width, height, radiance, times, 5));
    expect_sound(result.response);
    EXPECT_LT(rms_error(result.response.curves[0], 12, 0.1, 0.95), 0.01) << width << " x " << height;
  }
}

TEST(ResponseHardCases, ExposuresOverSixDecades) {
  const SensorTruth s = gamma_sensor(12);
  const auto radiance = test::log_uniform(20000, 10, 2e8, 6);
  const auto result = estimate(test::simulate_bracket(s, 200, 100, radiance, test::time_series(1e-5, 3.1623, 13), 7));
  expect_sound(result.response);
  EXPECT_TRUE(result.converged);
  EXPECT_LT(rms_error(result.response.curves[0], 12, 0.1, 0.95), 0.01);
}

TEST(ResponseHardCases, TimesOutOfOrder) {
  const SensorTruth s = gamma_sensor(10);
  auto frames = test::simulate_bracket(s, 60, 50, test::log_uniform(3000, 2e3, 2e6, 8), {0.001, 0.004, 0.002, 0.032, 0.016, 0.008}, 9);
  const auto mixed = estimate(frames);
  std::sort(frames.begin(), frames.end(), [](const auto& a, const auto& b) { return a.actual.exposure_s < b.actual.exposure_s; });
  EXPECT_EQ(mixed.response.curves[0].exposure, estimate(frames).response.curves[0].exposure);
}

TEST(ResponseHardCases, LevelsThatNoPixelHas) {
  // Only the lowest third and the top tenth of the range occur.
  const SensorTruth s = gamma_sensor(12);
  auto frames = test::simulate_bracket(s, 100, 100, test::log_uniform(10000, 1e4, 1e7, 10), test::time_series(0.001, 1.7, 10), 11);
  const Response whole = estimate(frames).response;
  for (RawFrame& f : frames)
    for (std::uint16_t& v : f.data)
      if (v > 1365 && v < 3686) v = 4095;
  const Response gap = estimate(frames).response;
  expect_sound(gap);
  // Little but smoothness links the two parts; the band says so and holds the error (3 sigma).
  for (const std::size_t v : {1700u, 2500u, 3000u, 3400u}) {
    const double sigma = *log_sigma_at(gap.curves[0], static_cast<double>(v)), mid = 2048;
    EXPECT_LT(std::abs(std::log(gap.curves[0].exposure[v] / (mid * std::pow(static_cast<double>(v) / mid, 1.8)))), 3 * sigma) << v;
    EXPECT_GT(sigma, 2 * *log_sigma_at(whole.curves[0], static_cast<double>(v))) << v;
  }
}

TEST(ResponseHardCases, LeftAlignedValuesAreRefusedAndCanBeShifted) {
  const SensorTruth s = gamma_sensor(12);
  const auto frames = test::simulate_bracket(s, 60, 50, test::log_uniform(3000, 1e4, 1e7, 12), test::time_series(0.001, 2, 7), 13);
  auto left = frames;
  for (RawFrame& f : left) {
    f.bits = 16;
    for (std::uint16_t& v : f.data) v = static_cast<std::uint16_t>(v << 4);
  }
  EXPECT_EQ(left_aligned_bits(frames), 0);
  EXPECT_NE(error_of(left).find("all values are multiples of 16: 12 bits stored left-aligned"), std::string::npos) << error_of(left);
  EXPECT_EQ(right_align(left), 4);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    EXPECT_EQ(left[i].bits, 12);
    EXPECT_EQ(left[i].data, frames[i].data);
  }
  // A few even values are no evidence.
  EXPECT_EQ(left_aligned_bits(std::vector<RawFrame>{{2, 1, PixelLayout::mono, 16, {32, 64}, {1, 0}}}), 0);
}

TEST(ResponseHardCases, SameBytesForAnyNumberOfThreads) {
  const auto frames = test::simulate_bracket(gamma_sensor(10), 90, 80, test::log_uniform(7200, 2e3, 2e6, 14), test::time_series(0.001, 2, 7), 15);
  const auto run = [&](std::size_t threads) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
    return estimate(frames);
  };
  const auto one = run(1), four = run(4);
  EXPECT_EQ(one.response.curves[0].exposure, four.response.curves[0].exposure);
  EXPECT_EQ(one.response.curves[0].band_log_sigma, four.response.curves[0].band_log_sigma);
  EXPECT_EQ(one.log_time_correction, four.log_time_correction);
}

}  // namespace
}  // namespace lacquer::calib
