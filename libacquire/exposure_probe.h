#pragma once

#include <array>
#include <functional>
#include <string>
#include <vector>

#include "libacquire/frame.h"
#include "libacquire/rig_check.h"

/// Is a camera linear in exposure, and black where its rig file says? Internal to check_rig.
namespace lacquer::acquire {

/// Values of a frame that a probe looks at: indices into RawFrame::data.
using ProbedValues = std::vector<std::size_t>;

/// What the probe measured at t/4, t/2 and t. Light: two frames each, in the order up and down, so that a steady drift cancels. Dark: one each.
struct ExposureProbe {
  static constexpr std::size_t n = 3;
  std::array<double, n> time_s{};     ///< read back, mean of the two frames
  std::array<double, n> signal_dn{};  ///< mean of (light - dark) over the values used
  std::array<double, n> sigma_dn{};   ///< of signal_dn, from the repeated frames and rounding
  std::array<double, n> dark_time_s{}, dark_dn{};  ///< of the dark frames: trimmed mean of all values probed
  double zero_share = 0;              ///< of the values of the shortest dark frame that are 0
  std::size_t n_used = 0;             ///< values bright in the longest frames and clipped in none
};

/// `light`, `dark`: take a frame of an exposure time. Two frames of `light` per time, one of `dark`.
ExposureProbe probe_exposures(const std::array<double, ExposureProbe::n>& times, const ProbedValues& values,
                              const std::function<RawFrame(double)>& light, const std::function<RawFrame(double)>& dark);

/// Signals in proportion to the times? `linear`: the rig file says so; else they only have to grow.
/// Warning beyond 2 % and 4 sigma, failed beyond 5 % and 6 sigma.
RigCheck judge_linearity(const ExposureProbe& probe, bool linear);

/// Dark frames against sensor.black_level_dn, and whether they are cut off at 0. Warning beyond 0.75 DN and 0.05 % of the range, failed
/// beyond 4 DN and 0.5 %.
RigCheck judge_black(const ExposureProbe& probe, double black_level_dn, double range_dn);

/// How much brighter dark frames get with time, beyond `dark_dn_per_s`, against the light. Warning from 1 % on.
RigCheck judge_darkness(const ExposureProbe& probe, double dark_dn_per_s);

/// Mean of the values within 8 robust standard deviations of their median: a few hot pixels do not count.
double trimmed_mean(std::vector<double> values);

}  // namespace lacquer::acquire
