#include "libacquire/rig_check.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "libacquire/capture_estimate.h"
#include "libacquire/exposure_probe.h"
#include "libacquire/guided_plan.h"
#include "libacquire/session.h"
#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

constexpr double degrees = 180 / 3.14159265358979323846;
constexpr std::size_t max_probed = 40000;

/// Takes frames off the plan, and makes the rig safe in the end.
class Prober {
 public:
  Prober(Rig& rig, const RigDescription& description, const Progress& progress) : rig_(rig), description_(description), progress_(progress) {
    for (const PlannedView& view : description.plan) planned_.insert(planned_.end(), view.exposures_s.begin(), view.exposures_s.end());
    const auto [least, most] = std::minmax_element(planned_.begin(), planned_.end());
    shortest_ = std::max(*least, rig.camera->limits().min_exposure_s);
    longest_ = std::min(*most, rig.camera->limits().max_exposure_s);
  }
  ~Prober() { rig_.make_safe(); }
  Prober(const Prober&) = delete;
  Prober& operator=(const Prober&) = delete;

  RawFrame take(double exposure_s) {
    if (progress_) progress_("check", n_taken_++, 0);
    const CameraLimits limits = rig_.camera->limits();
    exposure_s = std::clamp(exposure_s, limits.min_exposure_s, limits.max_exposure_s);
    while (std::find(planned_.begin(), planned_.end(), exposure_s) != planned_.end() && exposure_s > limits.min_exposure_s)
      exposure_s = std::max(0.99 * exposure_s, limits.min_exposure_s);
    RawFrame frame = rig_.camera->capture({.exposure_s = exposure_s, .gain_db = 0});
    check_format(frame, description_, "frame of " + rig_.camera->description());
    return frame;
  }
  RawFrame light(int index, double exposure_s) {
    rig_.lights->on(index);
    return take(exposure_s);
  }
  RawFrame dark(double exposure_s) {
    rig_.lights->off();
    return take(exposure_s);
  }
  double shortest() const { return shortest_; }
  double longest() const { return longest_; }

 private:
  Rig& rig_;
  const RigDescription& description_;
  const Progress& progress_;
  std::vector<double> planned_;
  double shortest_ = 0, longest_ = 0;
  std::size_t n_taken_ = 0;
};

/// Values of pixels where the rig file has the sphere's lit side, at most max_probed; all of the image where it has none.
ProbedValues lit_values(const RigDescription& rig, const PlannedView& view) {
  const CameraModel& camera = rig.geometry.camera;
  const PlacedLight light = rig.geometry.place_light(static_cast<std::size_t>(view.light), view.turntable_angle);
  const auto per_pixel = static_cast<std::size_t>(values_per_pixel(rig.sensor.layout));
  // An odd step meets all colours of a mosaic.
  const int step = 1 + 2 * static_cast<int>(std::sqrt(static_cast<double>(camera.width) * camera.height * static_cast<double>(per_pixel) / max_probed) / 2);
  ProbedValues lit, all;
  for (int y = 0; y < camera.height; y += step)
    for (int x = 0; x < camera.width; x += step)
      for (std::size_t k = 0; k < per_pixel; ++k) {
        const std::size_t value = (static_cast<std::size_t>(y) * static_cast<std::size_t>(camera.width) + static_cast<std::size_t>(x)) * per_pixel + k;
        all.push_back(value);
        const auto point = trace(rig.geometry, glm::dvec2(x, y));
        if (point && illuminate(light, *point)) lit.push_back(value);
      }
  return lit.size() >= 20 ? lit : all;
}

double mean_of(const RawFrame& frame, const ProbedValues& values) {
  std::vector<double> v;
  for (const std::size_t i : values) v.push_back(frame.data[i]);
  return trimmed_mean(std::move(v));
}

/// Exposure for which four fifths of the values stay below about half of the range; within the plan's times.
double probe_time(Prober& prober, const ProbedValues& values, int light, double black, double range) {
  double time = std::sqrt(prober.shortest() * prober.longest());
  for (int i = 0; i < 6; ++i) {
    const RawFrame frame = prober.light(light, time);
    std::vector<std::uint16_t> v;
    for (const std::size_t k : values) v.push_back(frame.data[k]);
    const auto high = v.begin() + static_cast<std::ptrdiff_t>(v.size() * 4 / 5);
    std::nth_element(v.begin(), high, v.end());
    const double level = (*high - black) / (range - black);
    if (level > 0.3 && level < 0.7) break;
    const double factor = level > 0.95 ? 0.125 : std::clamp(0.5 / std::max(level, 1e-3), 0.125, 8.0);
    const double next = std::clamp(time * factor, prober.shortest(), prober.longest());
    if (next == time) break;
    time = next;
  }
  return time;
}

std::string light_name(const RigDescription& rig, int light) { return rig.geometry.lights[static_cast<std::size_t>(light)].name; }

RigCheck check_light(Prober& prober, const RigDescription& rig, const PlannedView& view, double time) {
  const ProbedValues values = lit_values(rig, view);
  const RawFrame off = prober.dark(time), on = prober.light(view.light, time), off_again = prober.dark(time);
  const double dark = (mean_of(off, values) + mean_of(off_again, values)) / 2, change = mean_of(on, values) - dark;
  // The two dark frames say what "no change" is.
  const double no_change = std::abs(mean_of(off, values) - mean_of(off_again, values));
  RigCheck check{.name = fmt::format("light \"{}\": visible", light_name(rig, view.light)),
                 .text = fmt::format("{:+.1f} DN in {:.4g} ms on the lit side", change, on.actual.exposure_s * 1e3)};
  if (change > std::max(1.0, 5 * no_change)) return check;
  check.verdict = RigCheck::Verdict::failed;
  check.text += "; it does not change the image: power, wiring (chip, line, active_low), and that it is aimed at the sphere";
  return check;
}

RigCheck check_range(Prober& prober, const RigDescription& rig, const PlannedView& view, double range) {
  const ProbedValues values = lit_values(rig, view);
  const auto share = [&](const RawFrame& frame, auto&& predicate) {
    return 100.0 * static_cast<double>(std::count_if(values.begin(), values.end(), [&](std::size_t i) { return predicate(frame.data[i]); })) /
           static_cast<double>(values.size());
  };
  const auto clipped = [&](std::uint16_t v) { return v >= range; };
  const double in_shortest = share(prober.light(view.light, prober.shortest()), clipped);
  const RawFrame longest = prober.light(view.light, prober.longest()), dark = prober.dark(prober.longest());
  const double level = mean_of(dark, values);
  const double faint = share(longest, [&](std::uint16_t v) { return v < level + std::max(4.0, 1e-3 * range); });
  RigCheck check{.name = "exposures: range",
                 .text = fmt::format("clipped in the shortest: {:.2f} % of the lit side, in darkness in the longest: {:.2f} %", in_shortest, faint)};
  if (in_shortest > 0.5) check.text += "; plan a shorter exposure";
  if (faint > 10) check.text += "; plan a longer exposure";
  if (in_shortest > 0.5 || faint > 10) check.verdict = RigCheck::Verdict::warning;
  return check;
}

/// 1 degree on and back, to whatever side the limits allow.
RigCheck check_turntable(Rig& rig, double at) {
  RigCheck check{.name = "turntable: turns", .text = {}};
  const TurntableLimits limits = rig.turntable->limits();
  const double step = at + 1 / degrees <= limits.max_angle ? 1 / degrees : -1 / degrees;
  if (at + step < limits.min_angle) {
    check.text = rig.turntable->description() + ": stands still by its limits";
    return check;
  }
  const double before = rig.turntable->move_to(at), there = rig.turntable->move_to(at + step), back = rig.turntable->move_to(at);
  const double moved = (there - before) / step, missed = std::abs(back - before) * degrees;
  check.text = fmt::format("1 deg on: read back {:.4f} deg, back again within {:.4f} deg", moved, missed);
  if (std::abs(moved - 1) > 0.2 || missed > 0.2) {
    check.verdict = RigCheck::Verdict::failed;
    check.text += "; check gear_ratio, microsteps and backlash_deg";
  }
  return check;
}

std::array<double, ExposureProbe::n> probe_times(const Prober& prober, const CameraLimits& limits, double time) {
  time = std::clamp(time, prober.shortest(), limits.max_exposure_s);
  const double least = std::max(limits.min_exposure_s, time / 4);
  return {least, std::sqrt(least * time), time};
}

}  // namespace

std::vector<RigCheck> check_rig(Rig& rig, const RigDescription& description, CheckExtent extent, const Progress& progress) {
  std::vector<RigCheck> checks;
  const PlannedView* view = frontal_view(description, -1);
  if (description.kind == RigDescription::Kind::replay || !view) return checks;
  Prober prober(rig, description, progress);
  const SensorDescription& sensor = description.sensor;
  const double range = std::exp2(sensor.bits) - 1;
  if (const std::string warning = rig.camera->warning(); !warning.empty())
    checks.push_back({RigCheck::Verdict::warning, "camera: " + rig.camera->description(), warning});
  rig.turntable->move_to(view->turntable_angle);
  if (extent == CheckExtent::full) checks.push_back(check_turntable(rig, view->turntable_angle));

  const ProbedValues values = lit_values(description, *view);
  const double time = probe_time(prober, values, view->light, sensor.black_level_dn, range);
  const CameraLimits limits = rig.camera->limits();
  const auto times = probe_times(prober, limits, time);
  if (times[2] < 1.5 * times[0]) {
    checks.push_back({RigCheck::Verdict::warning, "camera: linear in exposure", "cannot be told: the camera has hardly more than one exposure time"});
  } else {
    const ExposureProbe probe = probe_exposures(times, values, [&](double t) { return prober.light(view->light, t); },
                                                [&](double t) { return prober.dark(t); });
    checks.push_back(judge_linearity(probe, sensor.response == SensorDescription::Response::linear));
    // A measured black level is that of the noise file.
    if (!sensor.noise_file && !sensor.maps_file) checks.push_back(judge_black(probe, sensor.black_level_dn, range));
    checks.push_back(judge_darkness(probe, sensor.dark_current_e_per_s / sensor.gain_e_per_dn));
  }
  if (extent == CheckExtent::quick) return checks;

  checks.push_back(check_range(prober, description, *view, range));
  for (int light = 0; light < rig.lights->n_lights(); ++light) {
    const PlannedView* frontal = frontal_view(description, light);
    if (!frontal) continue;
    rig.turntable->move_to(frontal->turntable_angle);
    checks.push_back(check_light(prober, description, *frontal, time));
  }
  return checks;
}

RigCheck check_free_space(const RigDescription& description, const std::filesystem::path& folder) {
  std::filesystem::path place = std::filesystem::absolute(folder.empty() ? std::filesystem::path(".") : folder).lexically_normal();
  std::error_code status;
  while (!std::filesystem::exists(place, status) && place != place.parent_path()) place = place.parent_path();
  const auto space = std::filesystem::space(place, status);
  const double needed = static_cast<double>(estimate_capture(description).frame_bytes), free = status ? 0 : static_cast<double>(space.available);
  RigCheck check{.name = "disk: free space", .text = fmt::format("the frames need {:.3g} GB, {:.3g} GB are free at {}", needed * 1e-9, free * 1e-9, place.string())};
  if (status) check = {RigCheck::Verdict::warning, check.name, place.string() + ": free space is not known: " + status.message()};
  else if (free < needed) check.verdict = RigCheck::Verdict::failed;
  return check;
}

}  // namespace lacquer::acquire
