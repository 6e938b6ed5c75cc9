#include <tbb/global_control.h>

#include <algorithm>
#include <cmath>

#include "bench/stability/brackets.h"
#include "bench/stability/hard_case.h"

/// Pixels about which no exposure says much.
namespace lacquer::bench {

namespace {

using namespace calib;
using acquire::RawFrame;

constexpr Sensor sensor_12{12, {"linear", [](double x) { return x; }, [](double v) { return v; }, true}, 64, 20000, 5};

RadianceImage merge(const Stack& s) { return merge_bracket(s.frames, s.sensor.response(), s.sensor.noise()); }

/// Mean of (merged - truth) / sigma.
double mean_pull(const Stack& s, const RadianceImage& image) {
  double sum = 0;
  for (std::size_t i = 0; i < s.truth.size(); ++i) sum += (image.radiance[i] - s.truth[i]) / std::sqrt(image.variance[i]);
  return sum / static_cast<double>(s.truth.size());
}

RadianceImage of_values(const std::vector<RawFrame>& frames, double black = 0) {
  NoiseModel noise;
  noise.black_level_dn = black;
  return merge_bracket(frames, linear_response(8, 1, black), noise);
}

HardCases both_ends() {
  HardCases cases;
  const auto clipped = of_values({mono(1, 1, 2, {255}), mono(1, 1, 0.5, {255}), mono(1, 1, 1, {255})});
  cases.push_back({"clipped in every exposure", "flag clipped, the largest lower bound (254.5 DN / 0.5 s), never an average", fmt::format("{:g} DN/s", clipped.radiance[0]), clipped.flags[0] == PixelFlag::clipped && clipped.radiance[0] == 509});
  const auto dark = of_values({mono(1, 1, 1, {13}), mono(1, 1, 1, {15})}, 16);
  cases.push_back({"below the black level in every exposure", "flag dark, the negative value and its variance are kept", fmt::format("{:g} ± {:.2f} DN/s", dark.radiance[0], std::sqrt(dark.variance[0])), dark.flags[0] == PixelFlag::dark && dark.radiance[0] == -2});
  const auto zero = of_values({mono(1, 1, 1, {0}), mono(1, 1, 4, {0})});
  cases.push_back({"0 in every exposure of a sensor without black level", "dark, not clipped, with an error", fmt::format("{:g} ± {:.2f} DN/s", zero.radiance[0], std::sqrt(zero.variance[0])), zero.flags[0] == PixelFlag::dark && zero.variance[0] > 0});
  const auto between = of_values({mono(1, 1, 0.001, {0}), mono(1, 1, 1, {255})});
  cases.push_back({"0 in 1 ms and clipped in 1 s: bounds only", "between the bounds (254.5 and some 2000 DN/s)", fmt::format("{:.0f} ± {:.0f} DN/s", between.radiance[0], std::sqrt(between.variance[0])), between.radiance[0] >= 254.5f && between.radiance[0] < 2300});
  const auto torn = of_values({mono(1, 1, 1, {50}), mono(1, 1, 2, {100}), mono(1, 1, 0.5, {255})});
  cases.push_back(at_most("a clipped value that the longer exposures contradict (50 DN/s)", "left out", std::abs(torn.radiance[0] / 50 - 1), 0.01, " relative"));
  return cases;
}

HardCases bias() {
  HardCases cases;
  const auto times = exposure_times(0.25e-3, 0.328, 16);
  const Scene threshold{120, 90, std::vector<double>(120 * 90 * 3, 1 / 0.328)};
  const Stack at_threshold = take_stack(sensor_12, threshold, times, 5);
  cases.push_back(at_most("a signal exactly at the clipping threshold of the longest exposure", "clipped values count as bounds; without that only negative noise would be kept", std::abs(mean_pull(at_threshold, merge(at_threshold))), 0.04, " σ mean error"));
  const Scene faint{120, 90, std::vector<double>(120 * 90 * 3, 2e-4 / 0.328)};
  const Stack four_electrons = take_stack(sensor_12, faint, times, 7);
  cases.push_back(at_most("four electrons in the longest exposure, read noise 5", "weights from the predicted, not the noisy value; a little bias is left, as the variance follows the merged value", std::abs(mean_pull(four_electrons, merge(four_electrons))), 0.1, " σ mean error"));
  const Stack decades = take_stack(sensor_12, log_uniform(60, 45, 1e-3, 1e4, 11), exposure_times(1e-4, 100, 7), 12);
  const RadianceImage image = merge(decades);
  double worst = 0;
  for (std::size_t i = 0; i < decades.truth.size(); ++i) worst = std::max(worst, std::abs(image.radiance[i] - decades.truth[i]) / std::sqrt(image.variance[i]));
  cases.push_back(at_most("exposures over six decades, light over seven", "every value finite; worst of 8100", worst, 5, " σ"));
  return cases;
}

HardCase order_and_threads() {
  const Stack s = take_stack(sensor_12, log_uniform(37, 23, 1e-3, 1e3, 6), exposure_times(0.25e-3, 0.328, 16), 7);
  const RadianceImage first = merge(s);
  Stack turned = s;
  std::reverse(turned.frames.begin(), turned.frames.end());
  const tbb::global_control one_thread(tbb::global_control::max_allowed_parallelism, 1);
  const RadianceImage second = merge(turned);
  std::size_t n = 0;
  for (std::size_t i = 0; i < first.radiance.size(); ++i) n += first.radiance[i] != second.radiance[i] || first.variance[i] != second.variance[i];
  return {"frames in the opposite order, one thread instead of all", "the same bytes", fmt::format("{} of {} values differ", n, first.radiance.size()), n == 0};
}

}  // namespace

HardCases merge_cases() {
  HardCases all = both_ends();
  for (const HardCase& c : bias()) all.push_back(c);
  all.push_back(order_and_threads());
  return all;
}

}  // namespace lacquer::bench
