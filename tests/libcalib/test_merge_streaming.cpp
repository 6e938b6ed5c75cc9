#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <random>

#include "libbrdf/error.h"
#include "libcalib/merge.h"
#include "libcalib/merge_weights.h"
#include "simulated_bracket.h"

namespace lacquer::calib {
namespace {

using acquire::PixelLayout;
using acquire::RawFrame;
using test::SensorTruth;
using test::expect_same_bytes;
using test::noise_of;
using test::paper_times;

RadianceImage merge_one_by_one(const std::vector<RawFrame>& frames, const Response& response, const NoiseModel& noise,
                               const SensorMaps& maps = {}) {
  std::vector<double> times;
  for (const RawFrame& f : frames) times.push_back(f.actual.exposure_s);
  BracketMerger merger(response, noise, times, maps);
  for (const RawFrame& f : frames) merger.add(f);
  return merger.finish();
}

Response curved(int bits, int n_channels, double black, double gamma) {
  Response response = linear_response(bits, n_channels, black);
  response.linear = false;
  const double mid = std::exp2(bits - 1) - black;
  for (ResponseCurve& curve : response.curves)
    for (double& e : curve.exposure) e = e > 0 ? mid * std::pow(e / mid, gamma) : e * 1e-3;
  return response;
}

TEST(MergeStreaming, FramesOneByOneGiveTheSameBytesAsTheBracketInMemory) {
  for (const PixelLayout layout : {PixelLayout::mono, PixelLayout::rgb, PixelLayout::bayer_gbrg})
    for (const bool linear : {true, false}) {
      SensorTruth s;
      s.layout = layout;
      if (!linear) s.curve = test::gamma_curve(12, s.black, 1.8);
      const int per_pixel = acquire::values_per_pixel(layout);
      const auto radiance = test::log_uniform(static_cast<std::size_t>(61 * 37 * per_pixel), 10, 1e7, 1);
      const auto frames = test::simulate_bracket(s, 61, 37, radiance, paper_times(), 2);
      const Response response = linear ? linear_response(12, acquire::n_channels(layout), s.black)
                                       : curved(12, acquire::n_channels(layout), s.black, 1.8);
      SCOPED_TRACE(acquire::name_of(layout) + (linear ? " linear" : " curved"));
      expect_same_bytes(merge_bracket(frames, response, noise_of(s)), merge_one_by_one(frames, response, noise_of(s)));
    }
}

// Float sums in another order: 1e-6 relative each, amplified up to tenfold where the three sums partly cancel.
TEST(MergeStreaming, AnyOrderOfArrivalGivesTheSameRadiance) {
  const SensorTruth s;
  auto frames = test::simulate_bracket(s, 60, 50, test::log_uniform(3000, 100, 1e7, 3), paper_times(), 4);
  const Response response = linear_response(12, 1, s.black);
  const RadianceImage sorted = merge_one_by_one(frames, response, noise_of(s));
  std::shuffle(frames.begin(), frames.end(), std::mt19937_64(5));
  const RadianceImage shuffled = merge_one_by_one(frames, response, noise_of(s));
  for (std::size_t i = 0; i < sorted.radiance.size(); ++i) {
    EXPECT_NEAR(shuffled.radiance[i], sorted.radiance[i], 2e-5 * std::abs(sorted.radiance[i]) + 1e-3 * std::sqrt(sorted.variance[i])) << i;
    EXPECT_NEAR(shuffled.variance[i], sorted.variance[i], 2e-3 * sorted.variance[i]) << i;
    EXPECT_EQ(shuffled.flags[i], sorted.flags[i]) << i;
  }
}

TEST(MergeStreaming, OneMergerTakesOneViewAfterAnother) {
  const SensorTruth s;
  const Response response = linear_response(12, 1, s.black);
  BracketMerger merger(response, noise_of(s), {0.001, 0.01, 0.1});
  for (unsigned view = 0; view < 3; ++view) {
    const auto frames = test::simulate_bracket(s, 31, 7, test::log_uniform(217, 100, 1e6, 6 + view), {0.001, 0.01, 0.1}, 9 + view);
    for (const RawFrame& f : frames) merger.add(f);
    expect_same_bytes(merger.finish(), merge_bracket(frames, response, noise_of(s)));
  }
}

// 16 times, four frames each: the variance is a quarter of that of one frame each (rounding and clipped pixels left out).
TEST(MergeStreaming, SixtyFourFramesAreMergedAndMoreAreRefused) {
  SensorTruth s;
  const auto radiance = test::log_uniform(5000, 1000, 1e6, 12);
  std::vector<double> times;
  for (const double t : paper_times()) times.insert(times.end(), 4, t);
  const auto frames = test::simulate_bracket(s, 100, 50, radiance, times, 13);
  const Response response = linear_response(12, 1, s.black);
  const RadianceImage image = merge_bracket(frames, response, noise_of(s));
  const RadianceImage streamed = merge_one_by_one(frames, response, noise_of(s));  // equal times come in another order here
  for (std::size_t i = 0; i < radiance.size(); ++i) EXPECT_NEAR(streamed.radiance[i], image.radiance[i], 1e-5 * image.radiance[i]);
  double sum = 0, squares = 0;
  for (std::size_t i = 0; i < radiance.size(); ++i) {
    const double z = (image.radiance[i] - radiance[i]) / std::sqrt(image.variance[i]);
    sum += z, squares += z * z;
  }
  EXPECT_NEAR(sum / 5000, 0, 0.06);  // standard error 0.014, and 0.02 of the truncation near the noise floor
  EXPECT_NEAR(std::sqrt(squares / 5000), 1, 0.035);
  times.push_back(1);
  EXPECT_THROW(BracketMerger(response, noise_of(s), times), Error);
}

// In units of DN: values of each pixel = black + offset + (light * flat + dark rate) * t.
TEST(MergeStreaming, MapsTakeOffsetDarkSignalAndFlatFieldOutAndFlagBadValues) {
  SensorTruth s;
  s.dark_current = 10;
  constexpr int width = 200, height = 100, n = width * height;
  std::mt19937_64 random(14);
  std::normal_distribution<double> normal;
  SensorMaps maps{.width = width, .height = height, .offset = {}, .dark_rate = {}, .flat = {}, .bad = {}};
  const auto light = test::log_uniform(n, 300, 1e6, 15);
  std::vector<double> seen(n);
  for (std::size_t i = 0; i < n; ++i) {
    maps.offset.push_back(static_cast<float>(std::round(4 * normal(random))));
    maps.dark_rate.push_back(static_cast<float>(5 * std::exp(normal(random))));
    maps.flat.push_back(static_cast<float>(1 + 0.05 * normal(random)));
    maps.bad.push_back(i % 1000 == 7);
    seen[i] = light[i] * maps.flat[i] + maps.dark_rate[i] - s.dark_current / s.gain;  // the simulation adds the nominal dark signal
  }
  auto frames = test::simulate_bracket(s, width, height, seen, paper_times(), 16);
  for (RawFrame& f : frames)
    for (std::size_t i = 0; i < n; ++i) {
      if (f.data[i] < 4095) f.data[i] = static_cast<std::uint16_t>(std::clamp(f.data[i] + static_cast<int>(maps.offset[i]), 0, 4095));
      if (maps.bad[i]) f.data[i] = 4095;
    }
  const RadianceImage image = merge_bracket(frames, linear_response(12, 1, s.black), noise_of(s), maps);
  double sum = 0, squares = 0, count = 0;
  for (std::size_t i = 0; i < n; ++i) {
    EXPECT_EQ(image.flags[i] == PixelFlag::invalid, maps.bad[i] == 1) << i;
    EXPECT_TRUE(std::isfinite(image.radiance[i]));
    if (maps.bad[i] || image.flags[i] == PixelFlag::clipped) continue;
    const double z = (image.radiance[i] - light[i]) / std::sqrt(image.variance[i]);
    sum += z, squares += z * z, count += 1;
  }
  EXPECT_NEAR(sum / count, 0, 0.03);  // standard error 0.007
  EXPECT_NEAR(std::sqrt(squares / count), 1, 0.03);
}

TEST(MergeStreaming, ErrorsOfFlatAndOffsetMapsEnterTheVariance) {
  RawFrame f{1, 1, PixelLayout::mono, 12, {1064}, {1, 0}};
  NoiseModel noise;
  noise.black_level_dn = 64, noise.read_noise_e = 0, noise.gain_e_per_dn = 1;
  SensorMaps maps{.width = 1, .height = 1, .offset = {0}, .dark_rate = {0}, .flat = {0.5}, .flat_sigma = 0.01, .bad = {}, .offset_sigma = 2,
                  .dark_rate_sigma = 3};
  const RadianceImage image = merge_bracket(std::vector{f}, linear_response(12, 1, 64), noise, maps);
  EXPECT_NEAR(image.radiance[0], 2000, 1e-3);
  // (1000 shot + 1/12 rounding + 4 offset + 9 dark rate) / flat^2 + (0.01 * 2000)^2
  EXPECT_NEAR(image.variance[0], (1000 + 1.0 / 12 + 4 + 9) / 0.25 + 400, 0.5);
}

TEST(MergeStreaming, RefusesWhatDoesNotFitAndNamesIt) {
  const Response response = linear_response(8, 1, 0);
  const RawFrame good{2, 1, PixelLayout::mono, 8, {1, 2}, {1, 0}};
  RawFrame wide = good, bright = good;
  wide.width = 1, wide.height = 2;
  bright.data[1] = 300;
  const auto error_of = [](const auto& work) -> std::string {
    try {
      work();
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::input);
      return e.what();
    }
    return "no error";
  };
  BracketMerger merger(response, {}, {1, 1});
  EXPECT_EQ(error_of([&] { merger.finish(); }), "bracket: expected at least one frame, got none");
  merger.add(good);
  EXPECT_EQ(error_of([&] { merger.add(wide); }), "frame 2 of 2: size: expected 2 x 1 as in frame 1, got 1 x 2");
  EXPECT_EQ(error_of([&] { merger.add(bright); }), "frame 2 of 2: value 300: expected less than 2^8 = 256");
  EXPECT_EQ(merger.n_frames(), 0u);  // the view begins anew
  merger.add(good);
  merger.add(good);
  EXPECT_EQ(error_of([&] { merger.add(good); }), "bracket: expected 2 frames as planned, got one more");
  EXPECT_EQ(error_of([&] { BracketMerger(response, {}, {}); }), "bracket: expected at least one frame, got none");
}

struct Bracket {
  const char* name;
  std::vector<double> times;
};

// The claim of merge_weights.h: the variance of the estimate against that of the ideal weights t / var, 1 / sum t^2 / var. 0.7 % of a
// standard deviation is 1.4 % of a variance (memorial with relative noise); of the sensors without it 0.4 %.
TEST(MergeWeights, LoseLessThanSevenPerMillOfSigmaAgainstTheIdealWeights) {
  const Bracket brackets[] = {{"paper", paper_times()}, {"six decades", test::time_series(1e-4, 10, 7)},
                              {"memorial", test::time_series(1.0 / 1024, 2, 16)}, {"two", {0.01, 0.1}}};
  for (const Bracket& bracket : brackets)
    for (const double relative : {0.0, 0.01}) {
      NoiseModel noise;
      noise.gain_e_per_dn = 4.2, noise.read_noise_e = 5, noise.relative_noise = relative;
      std::vector<ExposureNoise> exposures;
      for (const double t : bracket.times) exposures.push_back({t, 25 / (4.2 * 4.2) + 1.0 / 12});
      const double top = 4031, largest = top / bracket.times.front();
      const MergeWeights weights(exposures, {}, noise, 2 * largest);
      for (double x = 1e-2 / bracket.times.back(); x < largest; x *= 1.07) {
        std::int32_t count = 0;
        double ideal = 0;
        for (const double t : bracket.times)
          if (x * t < top) {
            ++count;
            ideal += t * t / (25 / (4.2 * 4.2) + 1.0 / 12 + x * t / 4.2 + std::pow(relative * x * t, 2));
          }
        const MergeWeightTable table = weights.table();
        const auto xf = static_cast<float>(x);
        const std::int32_t bin = table.bin_of(xf);
        const double variance = table.variance(table.at(0, count, bin), bin, xf);
        EXPECT_LT(variance * ideal, 1.014) << bracket.name << ", relative noise " << relative << ", x " << x;
        EXPECT_GT(variance * ideal, 0.98) << bracket.name << ", relative noise " << relative << ", x " << x;  // the line within a bin
      }
    }
}

TEST(MergeWeights, AnySetOfExposuresIsUnbiased) {
  NoiseModel noise;
  std::vector<ExposureNoise> exposures;
  for (const double t : paper_times()) exposures.push_back({t, 4});
  const MergeWeights weights(exposures, {}, noise, 1e7);
  for (const std::uint64_t set : {0b1ull, 0b100000000ull, 0b1010ull, 0b1100000011ull, 0xfffdull, 0xffffull})
    for (const float x : {0.0f, 10.0f, 3e3f, 1e6f}) {
      const MergeWeight w = weights.of_set(0, set, x);
      double gain = 0;
      for (std::size_t j = 0; j < exposures.size(); ++j)
        for (std::size_t k = 0; k < n_sums && (set >> j & 1); ++k) gain += w.a[k] * time_basis(exposures[j].time)[k] * exposures[j].time;
      EXPECT_NEAR(gain, 1, 2e-6) << set << " " << x;
    }
}

}  // namespace
}  // namespace lacquer::calib
