#include <algorithm>
#include <cmath>

#include "bench/stability/brackets.h"
#include "bench/stability/hard_case.h"
#include "libbrdf/error.h"
#include "libcalib/bracket_samples.h"
#include "libcalib/exposure_times.h"

/// Brackets that say little, or something false, about the response.
namespace lacquer::bench {

namespace {

using namespace calib;
using acquire::RawFrame;
using Brackets = std::vector<std::vector<RawFrame>>;

ResponseEstimate estimate(const std::vector<RawFrame>& frames) { return estimate_response(Brackets{frames}, {}); }

Stack gamma_stack(int bits, double low, double high, const std::vector<double>& times, unsigned seed) {
  return take_stack({bits, gamma_curve(), 0, 20000, 6}, log_uniform(120, 90, low, high, seed), times, seed + 1);
}

/// RMS of ln(curve / truth) from a tenth of the range to 95 % of it, worst channel.
double error(const Response& found, const Response& truth) {
  double worst = 0;
  for (std::size_t c = 0; c < found.curves.size(); ++c) {
    const std::size_t range = found.curves[c].exposure.size();
    double sum = 0, n = 0;
    for (std::size_t v = range / 10; v < range * 95 / 100; ++v, ++n) sum += std::pow(std::log(found.curves[c].exposure[v] / truth.curves[c].exposure[v]), 2);
    worst = std::max(worst, std::sqrt(sum / n));
  }
  return worst;
}

/// Entries of all curves that are not finite, or not above the one before.
std::size_t unsound(const Response& response) {
  std::size_t bad = 0;
  for (const ResponseCurve& curve : response.curves)
    for (std::size_t v = 0; v < curve.exposure.size(); ++v) bad += !std::isfinite(curve.exposure[v]) || (v > 0 && curve.exposure[v] <= curve.exposure[v - 1]);
  return bad;
}

HardCase sound(std::string what, std::string happens, const Response& response) {
  const std::size_t bad = unsound(response);
  return {std::move(what), std::move(happens), fmt::format("{} levels of {} not finite and rising", bad, response.curves[0].exposure.size()), bad == 0};
}

std::string refusal(const std::vector<RawFrame>& frames) {
  try {
    estimate(frames);
  } catch (const Error& e) {
    return e.what();
  }
  return "";
}

HardCase refused(std::string what, const std::string& text, const std::string& expected) {
  return {std::move(what), "refused in one line", "“" + (text.empty() ? "accepted" : text.substr(0, text.find(';'))) + "”", text.find(expected) != std::string::npos};
}

HardCases little_data() {
  HardCases cases;
  cases.push_back(refused("one frame", refusal({mono(2, 1, 0.5, {100, 120})}), "different exposure times"));
  cases.push_back(sound("one pixel in two frames", "a curve all the same, from the prior", estimate({mono(1, 1, 1, {50}), mono(1, 1, 2, {100})}).response));
  std::vector<std::uint16_t> bright(100), dark(100);
  for (std::size_t i = 0; i < 100; ++i) bright[i] = static_cast<std::uint16_t>(100 + i), dark[i] = static_cast<std::uint16_t>(50 + i / 2);
  cases.push_back(sound("frames that get darker with time, which no sensor does", "finite, rising", estimate({mono(10, 10, 1, bright), mono(10, 10, 2, dark), mono(10, 10, 4, dark)}).response));
  const Stack stack = gamma_stack(12, 0.1, 300, exposure_times(0.001, 0.1, 10), 10);
  auto gap = stack.frames;
  for (RawFrame& f : gap)
    for (std::uint16_t& v : f.data)
      if (v > 1365 && v < 3686) v = 4095;
  const Response truth = stack.sensor.response(), found = estimate(gap).response;
  double pull = 0;
  for (const std::size_t v : {1700u, 2500u, 3000u, 3400u})
    for (std::size_t c = 0; c < 3; ++c)
      pull = std::max(pull, std::abs(std::log(found.curves[c].exposure[v] / truth.curves[c].exposure[v])) / *log_sigma_at(found.curves[c], static_cast<double>(v)));
  cases.push_back(at_most("57 % of the range hit by no pixel", "the band widens over the gap and holds the error; worst of 12", pull, 3.5, " σ"));
  return cases;
}

HardCases hard_ranges() {
  HardCases cases;
  const Stack decades = gamma_stack(12, 0.01, 1e4, exposure_times(1e-5, 10, 13), 6);
  cases.push_back(at_most("exposures over six decades", "converges", error(estimate(decades.frames).response, decades.sensor.response()), 0.01, " rms of ln"));
  // A step of the times alone, so that only smoothness tells the curve within it.
  const Stack ratio = gamma_stack(12, 0.1, 300, exposure_times(0.001, 0.064, 4), 20);
  cases.push_back(at_most("four exposures of one ratio, 4: the curve is open up to a factor that repeats", "the smoothest of these curves", error(estimate(ratio.frames).response, ratio.sensor.response()), 0.03, " rms of ln"));
  const Stack linear = take_stack({12, linear_curve(), 0, 20000, 6}, log_uniform(120, 90, 0.1, 300, 30), exposure_times(0.001, 0.1, 10), 31);
  const auto found = estimate(linear.frames);
  cases.push_back({"a linear sensor", "recognised, no curve is fitted to its noise", found.response.linear ? "linear" : "curved", found.response.linear});
  return cases;
}

HardCases false_input() {
  HardCases cases;
  Stack stack = gamma_stack(12, 0.1, 300, exposure_times(0.001, 0.128, 8), 12);
  auto left = stack.frames;
  for (RawFrame& f : left) {
    f.bits = 16;
    for (std::uint16_t& v : f.data) v = static_cast<std::uint16_t>(v << 4);
  }
  cases.push_back(refused("12 bits stored in the upper part of 16", refusal(left), "left-aligned"));
  stack.frames[4].actual.exposure_s *= 1.5;
  const Brackets brackets{stack.frames};
  const auto estimated = estimate_response(brackets, {});
  const ExposureTimes times = exposure_times(brackets, 0, estimated);
  const bool named = times.false_frames == std::vector<std::size_t>{4};
  cases.push_back({"one of 8 times listed 50 % too long", "named; `merge` and `calibrate response` refuse it or, with --fit-times, correct it", fmt::format("frame 5 found {:.3f} of its listed time (truth 0.667)", times.fitted_s[4] / times.listed_s[4]), named && std::abs(times.fitted_s[4] / times.listed_s[4] * 1.5 - 1) < 0.01});
  return cases;
}

}  // namespace

HardCases response_cases() {
  HardCases all;
  for (const auto& part : {little_data(), hard_ranges(), false_input()}) all.insert(all.end(), part.begin(), part.end());
  return all;
}

}  // namespace lacquer::bench
