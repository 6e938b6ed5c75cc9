#include "libacquire/exposure_probe.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace lacquer::acquire {

namespace {

constexpr double rounding_dn = 0.29;       // RMS error of a rounded value; a bound for that of a mean of rounded values
constexpr double clipped_fraction = 0.9;   // of the largest value: sensors bend before they clip
constexpr double bright_fraction = 0.25;   // of the level that four fifths of the values stay below

double median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double mean_difference(const RawFrame& a, const RawFrame& b, const ProbedValues& used) {
  double sum = 0;
  for (const std::size_t i : used) sum += static_cast<double>(a.data[i]) - static_cast<double>(b.data[i]);
  return sum / static_cast<double>(used.size());
}

/// Values that are bright in the longest frames and clipped in none.
ProbedValues usable(const ProbedValues& values, const std::array<std::vector<RawFrame>, ExposureProbe::n>& light, const RawFrame& dark) {
  const auto& longest = light.back();
  const double clipped = clipped_fraction * ((1 << longest[0].bits) - 1);
  const auto signal = [&](std::size_t i) { return (longest[0].data[i] + longest[1].data[i]) / 2.0 - dark.data[i]; };
  std::vector<double> signals;
  for (const std::size_t i : values) signals.push_back(signal(i));
  const auto high = signals.begin() + static_cast<std::ptrdiff_t>(signals.size() * 4 / 5);
  std::nth_element(signals.begin(), high, signals.end());
  ProbedValues used;
  for (const std::size_t i : values) {
    bool good = signal(i) >= bright_fraction * *high;
    for (const auto& frames : light)
      for (const RawFrame& frame : frames) good = good && frame.data[i] < clipped;
    if (good) used.push_back(i);
  }
  return used;
}

std::string measured_text(const ExposureProbe& p) {
  return fmt::format("signals 1 : {:.3f} : {:.3f} for times 1 : {:.3f} : {:.3f}", p.signal_dn[1] / p.signal_dn[0], p.signal_dn[2] / p.signal_dn[0],
                     p.time_s[1] / p.time_s[0], p.time_s[2] / p.time_s[0]);
}

/// What may be wrong with a camera whose signals are not as its times.
std::string diagnosis(const ExposureProbe& p) {
  const double time_ratio = p.time_s[2] / p.time_s[0], signal_ratio = p.signal_dn[2] / p.signal_dn[0];
  if (signal_ratio < 1.2)
    return "the image does not follow the exposure time: an automatic exposure or gain is on, or the camera ignores the setting";
  const double slope = (p.signal_dn[2] - p.signal_dn[0]) / (p.time_s[2] - p.time_s[0]);
  const double at_middle = p.signal_dn[0] + slope * (p.time_s[1] - p.time_s[0]);
  const double extra_s = p.signal_dn[0] / slope - p.time_s[0];
  if (slope > 0 && std::abs(at_middle / p.signal_dn[1] - 1) < std::max(0.02, 4 * p.sigma_dn[1] / p.signal_dn[1]))
    return fmt::format("as if every exposure were {:.4g} ms {} than the camera says", std::abs(extra_s) * 1e3, extra_s > 0 ? "longer" : "shorter");
  return fmt::format("signals grow as time^{:.2f}: switch off gamma and contrast curves, or state sensor.response = \"estimate\"",
                     std::log(signal_ratio) / std::log(time_ratio));
}

}  // namespace

double trimmed_mean(std::vector<double> values) {
  if (values.empty()) return 0;
  const double centre = median(values);
  std::vector<double> distances;
  for (const double v : values) distances.push_back(std::abs(v - centre));
  const double limit = 8 * 1.4826 * median(distances) + 2;
  double sum = 0;
  std::size_t n = 0;
  for (const double v : values)
    if (std::abs(v - centre) <= limit) sum += v, ++n;
  return sum / static_cast<double>(n);
}

ExposureProbe probe_exposures(const std::array<double, ExposureProbe::n>& times, const ProbedValues& values,
                              const std::function<RawFrame(double)>& light, const std::function<RawFrame(double)>& dark) {
  std::array<std::vector<RawFrame>, ExposureProbe::n> lit;
  for (std::size_t i = 0; i < times.size(); ++i) lit[i].push_back(light(times[i]));
  for (std::size_t i = times.size(); i-- > 0;) lit[i].push_back(light(times[i]));
  std::vector<RawFrame> unlit;
  for (const double time : times) unlit.push_back(dark(time));

  ExposureProbe p;
  const ProbedValues used = usable(values, lit, unlit.back());
  p.n_used = used.size();
  double relative2 = 0;
  for (std::size_t i = 0; i < times.size(); ++i) {
    p.time_s[i] = (lit[i][0].actual.exposure_s + lit[i][1].actual.exposure_s) / 2;
    p.dark_time_s[i] = unlit[i].actual.exposure_s;
    std::vector<double> darkness;
    for (const std::size_t k : values) darkness.push_back(unlit[i].data[k]);
    p.dark_dn[i] = trimmed_mean(std::move(darkness));
    if (used.empty()) continue;
    const double a = mean_difference(lit[i][0], unlit[i], used), b = mean_difference(lit[i][1], unlit[i], used);
    p.signal_dn[i] = (a + b) / 2;
    if (p.signal_dn[i] > 0) relative2 += std::pow((a - b) / (a + b), 2) / static_cast<double>(times.size());
  }
  for (std::size_t i = 0; i < times.size(); ++i) p.sigma_dn[i] = std::hypot(std::sqrt(relative2) * p.signal_dn[i], rounding_dn);
  p.zero_share = static_cast<double>(std::count_if(values.begin(), values.end(), [&](std::size_t k) { return unlit[0].data[k] == 0; })) /
                 static_cast<double>(values.size());
  return p;
}

RigCheck judge_linearity(const ExposureProbe& p, bool linear) {
  RigCheck check{.name = "camera: linear in exposure", .text = {}};
  if (p.n_used < 10 || !(p.signal_dn[0] > 5 * p.sigma_dn[0])) {
    check.verdict = RigCheck::Verdict::warning;
    check.text = fmt::format("cannot be told: the light gives {:.1f} DN in {:.4g} ms, too little", p.signal_dn[2], p.time_s[2] * 1e3);
    return check;
  }
  if (!linear) {
    const bool grows = p.signal_dn[1] > 1.05 * p.signal_dn[0] && p.signal_dn[2] > 1.05 * p.signal_dn[1];
    check.name = "camera: brighter with exposure";
    check.verdict = grows ? RigCheck::Verdict::good : RigCheck::Verdict::failed;
    check.text = measured_text(p) + (grows ? "" : "; " + diagnosis(p));
    return check;
  }
  double worst = 0, sigma_of_worst = 0, excess = 0;  // excess: deviation over what is tolerated
  for (std::size_t i = 0; i + 1 < ExposureProbe::n; ++i) {
    const double deviation = p.signal_dn[i] / p.signal_dn[2] / (p.time_s[i] / p.time_s[2]) - 1;
    const double sigma = std::hypot(p.sigma_dn[i] / p.signal_dn[i], p.sigma_dn[2] / p.signal_dn[2]);
    if (std::abs(deviation) > std::abs(worst)) worst = deviation, sigma_of_worst = sigma;
    if (std::abs(deviation) > std::max(0.02, 4 * sigma)) excess = std::max(excess, 1.0);
    if (std::abs(deviation) > std::max(0.05, 6 * sigma)) excess = 2.0;
  }
  check.verdict = excess == 0 ? RigCheck::Verdict::good : excess < 2 ? RigCheck::Verdict::warning : RigCheck::Verdict::failed;
  check.text = fmt::format("{}, off by {:+.2f} +- {:.2f} %", measured_text(p), 100 * worst, 100 * sigma_of_worst);
  if (excess > 0) check.text += "; " + diagnosis(p);
  return check;
}

RigCheck judge_black(const ExposureProbe& p, double black_level_dn, double range_dn) {
  // Extrapolated to no exposure, so that dark current and room light do not count.
  const double span = p.dark_time_s[2] - p.dark_time_s[0];
  const double rate = span > 0 ? (p.dark_dn[2] - p.dark_dn[0]) / span : 0;
  const double black = p.dark_dn[0] - std::max(rate, 0.0) * p.dark_time_s[0], off = std::abs(black - black_level_dn);
  RigCheck check{.name = "camera: black level", .text = fmt::format("{:.2f} DN, the rig file says {:g}", black, black_level_dn)};
  if (off > std::max(0.75, 5e-4 * range_dn)) {
    check.verdict = off > std::max(4.0, 5e-3 * range_dn) ? RigCheck::Verdict::failed : RigCheck::Verdict::warning;
    check.text += "; correct sensor.black_level_dn or the camera's offset";
  } else if (p.zero_share > 0.05) {
    check.verdict = RigCheck::Verdict::warning;
    check.text += fmt::format("; {:.0f} % of the dark values are 0: noise is cut off, raise the camera's offset", 100 * p.zero_share);
  }
  return check;
}

RigCheck judge_darkness(const ExposureProbe& p, double dark_dn_per_s) {
  RigCheck check{.name = "room: dark", .text = {}};
  const double span = p.dark_time_s[2] - p.dark_time_s[0];
  const double rate = span > 0 ? (p.dark_dn[2] - p.dark_dn[0]) / span - dark_dn_per_s : 0;
  const double light_rate = p.signal_dn[2] / p.time_s[2];
  if (!(p.signal_dn[2] > 5 * p.sigma_dn[2]) || !(rate * span > 2 * rounding_dn)) {
    check.text = "dark frames do not get brighter with exposure";
    return check;
  }
  const double share = rate / light_rate;
  check.verdict = share > 0.01 ? RigCheck::Verdict::warning : RigCheck::Verdict::good;
  check.text = fmt::format("with all lights off {:.2f} % of the light is still there", 100 * share);
  if (share > 0.01) check.text += "; switch off the room's light, cover windows and pilot lamps, or plan dark views";
  return check;
}

}  // namespace lacquer::acquire
