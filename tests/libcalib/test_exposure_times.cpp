#include "libcalib/exposure_times.h"

#include <cmath>

#include "libbrdf/error.h"
#include "libcalib/frame_list.h"
#include "simulated_bracket.h"
#include "test_support.h"

namespace lacquer::calib {
namespace {

using acquire::RawFrame;
using test::SensorTruth;
using Frames = std::vector<std::size_t>;

/// Seven frames of 2 to 128 ms of a sensor with gamma 2.2 (or a linear one), every frame with values that are neither clipped nor dark.
std::vector<RawFrame> bracket(double gamma, unsigned seed, int bits = 10) {
  SensorTruth s;
  s.bits = bits, s.black = 0, s.gain = 20000 / std::exp2(bits), s.read_noise = 6;
  if (gamma != 1) s.curve = test::gamma_curve(bits, 0, gamma);
  const double full = std::exp2(bits - 1) * std::pow(2, gamma);
  return test::simulate_bracket(s, 50, 50, test::log_uniform(2500, full, full * 300, seed), test::time_series(0.002, 2, 7), seed + 77);
}

ExposureTimes with_curve(const std::vector<RawFrame>& frames) {
  const std::vector<std::vector<RawFrame>> brackets{frames};
  return exposure_times(brackets, 0, estimate_response(brackets));
}

ExposureTimes with_line(const std::vector<RawFrame>& frames) {
  return check_exposure_times(frames, linear_response(frames[0].bits, 1, 0), NoiseModel{});
}

TEST(ExposureTimes, NoFalseAlarmIn100Seeds) {
  for (unsigned seed = 0; seed < 100; ++seed) {
    const ExposureTimes times = seed % 2 ? with_line(bracket(1, seed)) : with_curve(bracket(2.2, seed, seed % 4 ? 8 : 12));
    EXPECT_EQ(times.false_frames, Frames{}) << seed;
  }
}

TEST(ExposureTimes, FivePerCentAreFoundInAnyFrame) {
  for (unsigned seed = 0; seed < 28; ++seed) {
    const std::size_t wrong = seed % 7;
    const double factor = seed % 2 ? 1.0527 : 0.95;
    auto curved = bracket(2.2, seed), linear = bracket(1, seed);
    curved[wrong].actual.exposure_s *= factor;
    linear[wrong].actual.exposure_s *= factor;
    const ExposureTimes a = with_curve(curved), b = with_line(linear);
    EXPECT_EQ(a.false_frames, Frames{wrong}) << seed;
    EXPECT_EQ(b.false_frames, Frames{wrong}) << seed;
    // Within the error that it states, 5 sigma for 56 of them, and 0.2 % for the gauge.
    const double truth = 0.002 * std::exp2(wrong);
    EXPECT_NEAR(a.fitted_s[wrong] / truth, 1, 5 * a.sigma[wrong] + 0.002);
    EXPECT_NEAR(b.fitted_s[wrong] / truth, 1, 5 * b.sigma[wrong] + 0.002);
  }
}

TEST(ExposureTimes, TwoThatAreSwappedAreBothNamed) {
  for (unsigned seed = 0; seed < 6; ++seed) {
    auto frames = bracket(2.2, seed);
    std::swap(frames[seed].actual.exposure_s, frames[seed + 1].actual.exposure_s);
    EXPECT_EQ(with_curve(frames).false_frames, (Frames{seed, seed + 1})) << seed;
  }
}

TEST(ExposureTimes, FlickerOfHalfAPerCentIsNotRefused) {
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal(0, 0.005);
  for (unsigned seed = 0; seed < 20; ++seed) {
    auto frames = bracket(2.2, seed);
    for (RawFrame& f : frames) f.actual.exposure_s *= std::exp(normal(random));
    EXPECT_EQ(with_curve(frames).false_frames, Frames{}) << seed;
  }
}

// Stated in the header: with an unknown curve an exponent of all times is one of the curve.
TEST(ExposureTimes, APowerLawOfAllTimesCannotBeSeenWithoutTheResponse) {
  auto frames = bracket(2.2, 1);
  for (RawFrame& f : frames) f.actual.exposure_s = std::pow(f.actual.exposure_s, 1.2);
  const ExposureTimes times = with_curve(frames);
  EXPECT_EQ(times.false_frames, Frames{});
  for (std::size_t i = 0; i < frames.size(); ++i) EXPECT_NEAR(times.fitted_s[i] / times.listed_s[i], 1, 0.003);
  // The known response sees it, in the fitted times.
  auto linear = bracket(1, 1);
  for (RawFrame& f : linear) f.actual.exposure_s = std::pow(f.actual.exposure_s, 1.2);
  const ExposureTimes seen = with_line(linear);
  EXPECT_NEAR(seen.fitted_s[6] / seen.fitted_s[0], 64, 0.3);
}

TEST(ExposureTimes, SigmaIsTheScatter) {
  double squares = 0, n = 0;
  for (unsigned seed = 0; seed < 40; ++seed) {
    const ExposureTimes times = with_line(bracket(1, 200 + seed));
    for (std::size_t i = 0; i < times.sigma.size(); ++i, ++n) squares += std::pow(std::log(times.fitted_s[i] / times.listed_s[i]) / times.sigma[i], 2);
  }
  EXPECT_NEAR(std::sqrt(squares / n), 1, 0.2);  // 280 values, two thirds of them independent; the gauge frame is 0 by definition
}

TEST(ExposureTimes, FramesThatShowNothingStayAsListed) {
  auto frames = bracket(1, 3);
  RawFrame clipped = frames[0];
  clipped.actual.exposure_s = 100;
  std::fill(clipped.data.begin(), clipped.data.end(), std::uint16_t{1023});
  frames.push_back(clipped);
  const ExposureTimes times = with_line(frames);
  EXPECT_EQ(times.false_frames, Frames{});
  EXPECT_EQ(times.fitted_s.back(), 100);
  EXPECT_TRUE(std::isinf(times.sigma.back()));
  EXPECT_EQ(with_line({frames[0]}).false_frames, Frames{});
}

TEST(ExposureTimes, TwoFramesThatContradictEachOtherAreBothNamed) {
  auto frames = bracket(1, 4);
  frames.resize(2);
  EXPECT_EQ(with_line(frames).false_frames, Frames{});
  frames[0].actual.exposure_s *= 1.5;
  EXPECT_EQ(with_line(frames).false_frames, (Frames{0, 1}));
}

TEST(ExposureTimes, FittedTimesRepairTheResponse) {
  auto frames = bracket(2.2, 5);
  frames[2].actual.exposure_s *= 1.7;
  const std::vector<std::vector<RawFrame>> brackets{frames};
  ResponseOptions options;
  options.fit_times = true;
  const ResponseEstimate estimate = estimate_response(brackets, options);
  double squares = 0;
  for (std::size_t v = 100; v < 970; ++v)
    squares += std::pow(std::log(estimate.response.curves[0].exposure[v] / (512 * std::pow(static_cast<double>(v) / 512, 2.2))), 2) / 870;
  EXPECT_LT(std::sqrt(squares), 0.01);  // 2500 pixels; with the false time it is 0.1
  use_fitted_times(exposure_times(brackets, 0, estimate), frames);
  EXPECT_NEAR(frames[2].actual.exposure_s, 0.008, 0.00005);
}

TEST(ExposureTimes, TheErrorNamesListFrameAndTimes) {
  const ExposureTimes times{{1.0 / 30, 1.0 / 15, 2}, {1.0 / 30, 0.128, 2}, {0.001, 0.004, 0.001}, {1}};
  const std::vector<std::string> names{"a.png", "img_05.png", "c.png"};
  try {
    refuse_false_times(times, "list.csv", names);
    ADD_FAILURE();
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::input);
    EXPECT_STREQ(e.what(), "list.csv: frame 2 (img_05.png): listed 1/15 s, the pixels say 0.1280 s +- 0.0005 (1.92 x); correct the list or use --fit-times");
  }
  refuse_false_times({{1}, {1}, {0.1}, {}}, "list.csv", names);
}

struct Memorial {
  static std::vector<RawFrame> frames() {
    const std::filesystem::path folder = test::shared_data() / "brackets/memorial";
    std::ifstream in(folder / "shutter_times.txt");
    const test::TemporaryFolder lists;
    std::string list = "file,exposure_s\n", time;
    for (int i = 61; in >> time; ++i) list += std::filesystem::absolute(folder).string() + "/memorial00" + std::to_string(i) + ".png," + time + "\n";
    test::write_file(lists / "list.csv", list);
    return read_listed_frames(lists / "list.csv", 8, acquire::PixelLayout::mono);
  }
};

// Film, a mechanical shutter: frames are up to 20 % off, two in three by less than 6 %.
TEST(ExposureTimes, MemorialIsNotRefused) {
  LACQUER_NEEDS_SHARED_DATA("brackets/memorial");
  EXPECT_EQ(with_curve(Memorial::frames()).false_frames, Frames{});
}

TEST(ExposureTimes, MemorialWithAFrameRelabelledByAStopIsRefused) {
  LACQUER_NEEDS_SHARED_DATA("brackets/memorial");
  auto frames = Memorial::frames();
  frames[6].actual.exposure_s *= 2;
  EXPECT_EQ(with_curve(frames).false_frames, Frames{6});
}

}  // namespace
}  // namespace lacquer::calib
