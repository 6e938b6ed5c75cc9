#include "libcalib/response.h"

#include <cmath>

#include "libbrdf/error.h"
#include "libcalib/noise_model.h"
#include "simulated_bracket.h"
#include "test_support.h"

namespace lacquer::calib {
namespace {

using acquire::PixelLayout;
using acquire::RawFrame;
using test::SensorTruth;

std::vector<double> paper_times() { return test::time_series(0.25e-3, std::pow(328 / 0.25, 1.0 / 15), 16); }

ResponseEstimate estimate(const std::vector<RawFrame>& frames, double black) {
  ResponseOptions options;
  options.black_level_dn = black;
  return estimate_response(std::vector<std::vector<RawFrame>>{frames}, options);
}

/// RMS of ln(curve / truth) over the values from `low` to `high`; truth in the curve's own gauge.
template <typename Truth>
double rms_error(const ResponseCurve& curve, std::size_t low, std::size_t high, const Truth& truth) {
  double sum = 0;
  for (std::size_t v = low; v <= high; ++v) sum += std::pow(std::log(curve.exposure[v] / truth(static_cast<double>(v))), 2);
  return std::sqrt(sum / static_cast<double>(high - low + 1));
}

void expect_increasing(const Response& response) {
  for (const ResponseCurve& curve : response.curves) {
    ASSERT_EQ(curve.exposure.size(), std::size_t{1} << response.bits);
    for (std::size_t v = 0; v < curve.exposure.size(); ++v) {
      ASSERT_TRUE(std::isfinite(curve.exposure[v])) << v;
      if (v == 0) continue;
      ASSERT_GT(curve.exposure[v], curve.exposure[v - 1]) << v;
    }
  }
}

void expect_gauge(const Response& response, double black) {
  const auto mid = std::size_t{1} << (response.bits - 1);
  for (const ResponseCurve& curve : response.curves)
    EXPECT_NEAR(curve.exposure[mid], static_cast<double>(mid) - black, 1e-6 * static_cast<double>(mid));
}

TEST(Response, LinearResponseIsTheValueAboveBlack) {
  const Response r = linear_response(10, 3, 60);
  ASSERT_EQ(r.curves.size(), 3u);
  EXPECT_EQ(r.curves[2].exposure[0], -60);
  EXPECT_EQ(r.curves[1].exposure[512], 452);
  EXPECT_TRUE(r.linear);
}

struct Case {
  int bits;
  double black, gain, gamma;
};

class EveryDepth : public testing::TestWithParam<Case> {};

// 25000 pixels of shot noise give about 0.05 % per knot; the rest of the tolerance is for 8 bit, where rounding takes part.
// Checked from 10 % of the range (with gamma 2.2 that is 0.6 % of the exposure, near the noise of this sensor) to 95 %.
TEST_P(EveryDepth, RecoversTheCurveOfASensor) {
  const auto [bits, black, gain, gamma] = GetParam();
  SensorTruth s;
  s.bits = bits, s.black = black, s.gain = gain, s.read_noise = 5;
  s.curve = test::gamma_curve(bits, black, gamma);
  const double range = std::exp2(bits), mid = range / 2 - black;
  const auto radiance = test::log_uniform(40000, 0.3 * range, 2000 * range, 1);
  const auto result = estimate(test::simulate_bracket(s, 200, 200, radiance, paper_times(), 2), black);
  expect_increasing(result.response);
  expect_gauge(result.response, black);
  const auto low = static_cast<std::size_t>(black + 0.1 * range), high = static_cast<std::size_t>(0.95 * range);
  EXPECT_LT(rms_error(result.response.curves[0], low, high, [&](double v) { return mid * std::pow((v - black) / mid, gamma); }),
            bits == 8 ? 0.006 : 0.0025);
}

INSTANTIATE_TEST_SUITE_P(Response, EveryDepth,
                         testing::Values(Case{8, 0, 40, 1}, Case{8, 0, 400, 1.8}, Case{10, 20, 10, 1.4}, Case{12, 64, 4, 1},
                                         Case{12, 64, 4, 1.8}, Case{14, 200, 1, 2.2}, Case{16, 256, 0.5, 1}, Case{16, 256, 0.5, 1.6}),
                         [](const auto& info) {
                           return std::to_string(info.param.bits) + "bit_gamma" + std::to_string(int(std::lround(10 * info.param.gamma)));
                         });

// A curve that is no power law: the shoulder of film, v = 4095 e / (e + k).
TEST(Response, RecoversAShoulder) {
  SensorTruth s;
  s.black = 0, s.gain = 4;
  // Gauge: 2048 <-> 2048, so k = 2047.
  s.curve = [](double e) { return e > 0 ? 4095 * e / (e + 2047) : e; };
  const auto radiance = test::log_uniform(40000, 2000, 1e7, 3);
  const auto result = estimate(test::simulate_bracket(s, 200, 200, radiance, paper_times(), 4), 0);
  EXPECT_LT(rms_error(result.response.curves[0], 200, 3700, [](double v) { return 2047 * v / (4095 - v); }), 0.005);
}

TEST(Response, EachChannelOfRgbAndMosaicHasItsOwnCurve) {
  SensorTruth s;
  s.bits = 10, s.black = 0, s.gain = 20;
  const auto radiance = test::log_uniform(30000, 300, 1e6, 5);
  const auto times = test::time_series(0.001, 1.9, 9);
  // Channel c has gamma 1 + 0.4 c: three gray simulations, interleaved by hand.
  std::vector<std::vector<RawFrame>> gray;
  for (int c = 0; c < 3; ++c) {
    s.curve = test::gamma_curve(10, 0, 1 + 0.4 * c);
    gray.push_back(test::simulate_bracket(s, 200, 150, radiance, times, 6 + static_cast<unsigned>(c)));
  }
  std::vector<RawFrame> rgb, mosaic;
  for (std::size_t j = 0; j < times.size(); ++j) {
    RawFrame a{200, 150, PixelLayout::rgb, 10, std::vector<std::uint16_t>(90000), {times[j], 0}};
    RawFrame b{200, 150, PixelLayout::bayer_gbrg, 10, std::vector<std::uint16_t>(30000), {times[j], 0}};
    for (std::size_t i = 0; i < 30000; ++i) {
      for (std::size_t c = 0; c < 3; ++c) a.data[3 * i + c] = gray[c][j].data[i];
      const std::size_t x = i % 200, y = i / 200;
      const std::size_t channel = x % 2 == y % 2 ? 1 : (x % 2 == 1 ? 2 : 0);  // G B / R G
      b.data[i] = gray[channel][j].data[i];
    }
    rgb.push_back(a);
    mosaic.push_back(b);
  }
  for (const auto* frames : {&rgb, &mosaic}) {
    const auto result = estimate(*frames, 0);
    ASSERT_EQ(result.response.curves.size(), 3u);
    for (int c = 0; c < 3; ++c)
      EXPECT_LT(rms_error(result.response.curves[static_cast<std::size_t>(c)], 60, 970,
                          [&](double v) { return 512 * std::pow(v / 512, 1 + 0.4 * c); }),
                0.01)
          << acquire::name_of((*frames)[0].layout) << " channel " << c;
  }
}

TEST(Response, LevelsThatNoPixelHasAreInterpolated) {
  // A scene of two radiances and three exposures: six levels of 4096.
  const SensorTruth s;
  std::vector<double> radiance(4000, 20000);
  std::fill(radiance.begin() + 2000, radiance.end(), 60000);
  const auto result = estimate(test::simulate_bracket(s, 80, 50, radiance, {0.01, 0.02, 0.04}, 7), s.black);
  expect_increasing(result.response);
  expect_gauge(result.response, s.black);
  EXPECT_LT(rms_error(result.response.curves[0], 264, 3000, [&](double v) { return v - s.black; }), 0.05);
}

TEST(Response, ContradictingPixelsHardlyMoveTheCurve) {
  SensorTruth s;
  const auto radiance = test::log_uniform(40000, 1000, 5e6, 8);
  auto frames = test::simulate_bracket(s, 200, 200, radiance, paper_times(), 9);
  // Something moved through 3 % of the picture in one frame.
  for (std::size_t i = 0; i < 1200; ++i) frames[8].data[i] = static_cast<std::uint16_t>(500 + i % 900);
  const auto result = estimate(frames, s.black);
  EXPECT_LT(rms_error(result.response.curves[0], 264, 3900, [&](double v) { return v - s.black; }), 0.005);
}

TEST(Response, OrderOfFramesDoesNotMatter) {
  const SensorTruth s;
  auto frames = test::simulate_bracket(s, 60, 50, test::log_uniform(3000, 1000, 5e6, 10), {0.001, 0.004, 0.016, 0.064}, 11);
  const auto first = estimate(frames, s.black);
  std::swap(frames[0], frames[3]);
  std::swap(frames[1], frames[2]);
  EXPECT_EQ(first.response.curves[0].exposure, estimate(frames, s.black).response.curves[0].exposure);
}

TEST(Response, RefusesBracketsThatSayNothing) {
  const auto error_of = [](const std::vector<std::vector<RawFrame>>& brackets) -> std::string {
    try {
      estimate_response(brackets);
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::input);
      return e.what();
    }
    return "no error";
  };
  const RawFrame f{2, 1, PixelLayout::mono, 8, {1, 2}, {0.5, 0}};
  RawFrame deep = f, longer = f;
  deep.bits = 10;
  longer.actual.exposure_s = 1;
  EXPECT_NE(error_of({}).find("expected at least one bracket"), std::string::npos);
  EXPECT_NE(error_of({{f, f, f}}).find("expected frames with different exposure times"), std::string::npos);
  EXPECT_NE(error_of({{f, longer}, {deep}}).find("same bits and layout"), std::string::npos);
}

TEST(Response, AllClippedOrAllDarkFramesAreRefusedInOneLine) {
  for (const auto value : {std::uint16_t{0}, std::uint16_t{255}}) {
    std::vector<RawFrame> frames;
    for (const double t : {1.0, 2.0, 4.0}) frames.push_back({8, 8, PixelLayout::mono, 8, std::vector<std::uint16_t>(64, value), {t, 0}});
    try {
      estimate(frames, 0);
      ADD_FAILURE() << value;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::input);
      EXPECT_NE(std::string(e.what()).find("no pixel has values between black and saturation (255) at two exposure times"), std::string::npos) << e.what();
    }
  }
}

TEST(Response, ComesBackFromItsFile) {
  const test::TemporaryFolder folder;
  Response response = linear_response(8, 3, 0);
  response.linear = false;
  for (std::size_t c = 0; c < 3; ++c)
    for (std::size_t v = 0; v < 256; ++v) response.curves[c].exposure[v] = 128 * std::pow(static_cast<double>(v) / 128, 1 + 0.3 * static_cast<double>(c));
  write_response(folder / "r.json", response);
  const Response back = read_response(folder / "r.json");
  EXPECT_EQ(back.bits, 8);
  EXPECT_FALSE(back.linear);
  ASSERT_EQ(back.curves.size(), 3u);
  for (std::size_t c = 0; c < 3; ++c) EXPECT_EQ(back.curves[c].exposure, response.curves[c].exposure);
  test::write_file(folder / "bad.json", R"({"version": 2})");
  try {
    read_response(folder / "bad.json");
    ADD_FAILURE();
  } catch (const Error& e) {
    EXPECT_NE(std::string(e.what()).find("bad.json: version: expected 1, got 2"), std::string::npos) << e.what();
  }
}

// Of the sensor, not of the picture: gain and read noise come back within 10 and 15 % (medians of some 1e5 pairs, coupled to each other).
TEST(NoiseEstimate, FindsGainAndReadNoiseFromTheBracket) {
  SensorTruth s;
  s.gain = 4, s.read_noise = 12;
  const auto frames = test::simulate_bracket(s, 200, 200, test::log_uniform(40000, 50, 5e6, 12), paper_times(), 13);
  NoiseModel known;
  known.black_level_dn = s.black;
  const NoiseModel noise = estimate_noise(std::vector<std::vector<RawFrame>>{frames}, linear_response(12, 1, s.black), known);
  EXPECT_NEAR(noise.gain_e_per_dn, 4, 0.4);
  EXPECT_NEAR(noise.read_noise_e, 12, 1.8);
  EXPECT_LT(noise.relative_noise, 0.005);
}

}  // namespace
}  // namespace lacquer::calib
