#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <set>
#include <string_view>
#include <vector>

#include "libacquire/nearest_name.h"
#include "libacquire/rig_parsing.h"
#include "libbrdf/error.h"

namespace lacquer::acquire::detail {

namespace {

constexpr std::size_t max_views = 100000;
constexpr std::size_t max_exposures = 1000;
constexpr Range degrees = {-3600, 3600};
constexpr Range exposure_s = {1e-9, 1e5, false};

/// A list, or {from, to, step} with both ends.
std::vector<double> read_angles(const TomlTable& plan) {
  std::vector<double> angles;
  if (plan.is_table("angles_deg")) {
    const TomlTable t = *plan.table("angles_deg", {"from", "to", "step"});
    const double from = t.number("from", degrees), to = t.number("to", degrees), step = t.number("step", degrees);
    const double steps = step == 0 ? -1 : (to - from) / step;
    if (!(steps >= 0) || std::abs(steps - std::round(steps)) > 1e-6)
      t.fail("step", fmt::format("expected a step that leads from {} to {} in whole steps, got {}", from, to, step));
    if (steps >= static_cast<double>(max_views)) t.fail("step", fmt::format("expected at most {} angles", max_views));
    for (int i = 0; i <= static_cast<int>(std::round(steps)); ++i) angles.push_back(from + i * step);
  } else if (plan.has("angles_deg") && !plan.is_array("angles_deg")) {
    angles = {plan.number("angles_deg", degrees)};
  } else {
    angles = plan.numbers("angles_deg", degrees, 1, max_views);
  }
  for (double& a : angles) a *= radians_per_degree;
  return angles;
}

/// A list, or {from, to, count} with equal ratios.
std::vector<double> read_exposures(const TomlTable& plan) {
  const Range ms = {exposure_s.min * 1e3, exposure_s.max * 1e3, false};
  std::vector<double> times;
  if (plan.is_table("exposures_ms")) {
    const TomlTable t = *plan.table("exposures_ms", {"from", "to", "count"});
    const double from = t.number("from", ms), to = t.number("to", ms);
    const auto count = t.integer("count", 1, static_cast<std::int64_t>(max_exposures));
    if (count == 1 ? from != to : !(from < to)) t.fail("to", fmt::format("expected more than {} (the same for a count of 1), got {}", from, to));
    for (std::int64_t i = 0; i < count; ++i)
      times.push_back(count == 1 ? from : from * std::pow(to / from, static_cast<double>(i) / static_cast<double>(count - 1)));
  } else {
    times = plan.numbers("exposures_ms", ms, 1, max_exposures);
    if (std::adjacent_find(times.begin(), times.end(), std::greater_equal<>()) != times.end())
      plan.fail("exposures_ms", "expected ascending times");
  }
  for (double& t : times) t *= 1e-3;
  return times;
}

/// Names or indices of lights.
std::vector<int> read_light_choice(const TomlTable& plan, const RigGeometry& geometry) {
  const auto& lights = geometry.lights;
  std::vector<int> chosen;
  if (plan.is_string_array("lights")) {
    for (const std::string& name : plan.strings("lights", max_views)) {
      const auto found = std::find_if(lights.begin(), lights.end(), [&](const Light& l) { return l.name == name; });
      if (found == lights.end()) {
        std::vector<std::string_view> names;
        for (const Light& l : lights) names.push_back(l.name);
        plan.fail("lights", fmt::format("no light is named \"{}\"; did you mean \"{}\"?", name, nearest_name(name, names)));
      }
      chosen.push_back(static_cast<int>(found - lights.begin()));
    }
    return chosen;
  }
  const double last = static_cast<double>(lights.size() - 1);
  for (const double index : plan.numbers("lights", {0, last}, 1, max_views)) {
    if (index != std::floor(index)) plan.fail("lights", fmt::format("expected names or whole numbers from 0 to {}, got {}", last, index));
    chosen.push_back(static_cast<int>(index));
  }
  return chosen;
}

void plan_captures(const TomlTable& plan, RigDescription& rig) {
  const std::vector<double> angles = read_angles(plan), exposures = read_exposures(plan);
  std::vector<int> lights(rig.geometry.lights.size());
  std::iota(lights.begin(), lights.end(), 0);
  if (plan.has("lights")) lights = read_light_choice(plan, rig.geometry);
  if (angles.size() * lights.size() > max_views)
    plan.fail("", fmt::format("{} angles with {} lights each; expected at most {} views", angles.size(), lights.size(), max_views));
  for (const double angle : angles)
    for (const int light : lights) rig.plan.push_back({angle, light, exposures, {}});
}

/// The first view of each light again after every `reference_every` views and at the end.
void plan_references(const TomlTable& plan, RigDescription& rig) {
  if (!plan.has("reference_every")) return;
  const auto every = static_cast<std::size_t>(plan.integer("reference_every", 1, static_cast<std::int64_t>(max_views)));
  const std::vector<PlannedView> views = std::move(rig.plan);
  const std::size_t n_rounds = (views.size() + every - 1) / every;
  // With the first views themselves five points in time: fewer do not tell a drift from flicker (libcalib/drift.h).
  constexpr std::size_t min_rounds = 4;
  if (n_rounds < min_rounds)
    plan.fail("reference_every", fmt::format("{} views with references after every {} are {} rounds; expected {} or more, so that a drift can be "
                                             "told from flicker", views.size(), every, n_rounds, min_rounds));
  std::vector<PlannedView> round;
  std::set<int> seen;
  for (const PlannedView& view : views)
    if (seen.insert(view.light).second) round.push_back(view);
  for (PlannedView& view : round) view.kind = ViewKind::reference;
  if (views.size() + n_rounds * round.size() > max_views)
    plan.fail("reference_every", fmt::format("{} views and {} references; expected at most {} together", views.size(), n_rounds * round.size(), max_views));
  rig.plan.clear();
  for (std::size_t v = 0; v < views.size(); ++v) {
    rig.plan.push_back(views[v]);
    if ((v + 1) % every == 0 || v + 1 == views.size()) rig.plan.insert(rig.plan.end(), round.begin(), round.end());
  }
}

/// Views without light at the end, when the camera is as warm as it was most of the time: one frame of each exposure time in each.
void plan_darks(const TomlTable& plan, RigDescription& rig) {
  const auto n_frames = plan.integer("dark_frames", 0, static_cast<std::int64_t>(max_exposures), 0);
  if (n_frames == 0) return;
  if (n_frames == 1) plan.fail("dark_frames", "expected 0 or at least 2 of each exposure time; one does not tell noise from what is fixed");
  PlannedView dark = rig.plan.back();
  if (dark.exposures_s.size() < 2) plan.fail("dark_frames", "expected exposures_ms with two or more times; one does not tell dark current from black level");
  dark.light = -1;
  dark.kind = ViewKind::dark;
  rig.plan.insert(rig.plan.end(), static_cast<std::size_t>(n_frames), dark);
}

void read_adaptive(const TomlTable& plan, RigDescription& rig) {
  constexpr double usual_loss = 0.01;
  const double loss = plan.number("adaptive_loss", Range::above(0, 10), usual_loss);
  if (!plan.boolean("adaptive", false)) {
    if (plan.has("adaptive_loss")) plan.fail("adaptive_loss", "only with adaptive = true");
    return;
  }
  if (rig.sensor.response != SensorDescription::Response::linear)
    plan.fail("adaptive", "only with sensor.response = \"linear\"; a curve is found from whole brackets");
  rig.adaptive_loss = loss;
}

/// "photo_%03d.png" with 7 -> "photo_007.png".
std::string numbered_name(const std::string& pattern, std::int64_t number, const TomlTable& replay) {
  const std::size_t percent = pattern.find('%');
  std::size_t at = percent == std::string::npos ? pattern.size() : percent + 1;
  std::size_t width = 0;
  const bool zeros = at < pattern.size() && pattern[at] == '0';
  while (at < pattern.size() && pattern[at] >= '0' && pattern[at] <= '9' && width < 100) width = 10 * width + (pattern[at++] - '0');
  if (at >= pattern.size() || pattern[at] != 'd' || width > 20 || pattern.find('%', at) != std::string::npos)
    replay.fail("file_pattern", fmt::format("expected one number such as %03d in it, got \"{}\"", pattern));
  std::string digits = std::to_string(number);
  if (digits.size() < width) digits.insert(0, width - digits.size(), zeros ? '0' : ' ');
  return pattern.substr(0, percent) + digits + pattern.substr(at + 1);
}

std::vector<std::filesystem::path> replay_files(const TomlTable& replay, const RigFiles& files) {
  std::vector<std::string> names;
  const bool pattern = replay.has("file_pattern");
  if (pattern == replay.has("files")) replay.fail("files", "expected either a list of files, or file_pattern with first and last");
  if (pattern) {
    const std::string text = replay.string("file_pattern");
    const std::int64_t first = replay.integer("first", 0, 1000000000), last = replay.integer("last", first, first + max_views - 1);
    for (std::int64_t i = first; i <= last; ++i) names.push_back(numbered_name(text, i, replay));
  } else {
    for (const char* key : {"first", "last"})
      if (replay.has(key)) replay.fail(key, "only with file_pattern");
    names = replay.strings("files", max_views);
  }
  std::vector<std::filesystem::path> result;
  for (const std::string& name : names) result.push_back(std::filesystem::absolute(files.in_data_folder(name)).lexically_normal());
  return result;
}

/// One value for all views, one per view, or (empty list) the fallback.
template <typename T>
T of_view(const std::vector<T>& values, std::size_t view, T fallback) {
  return values.empty() ? fallback : values.size() == 1 ? values[0] : values[view];
}

void plan_replay(const std::optional<TomlTable>& plan, const TomlTable& replay, const RigFiles& files, RigDescription& rig) {
  const auto paths = replay_files(replay, files);
  const auto per_view = static_cast<std::size_t>(replay.integer("frames_per_view", 1, max_exposures, 1));
  if (paths.size() % per_view != 0)
    replay.fail("frames_per_view", fmt::format("{} files cannot be divided into views of {}", paths.size(), per_view));
  const std::size_t n_views = paths.size() / per_view;

  std::vector<double> times = {1.0};
  if (replay.has("exposures_s"))
    times = replay.is_array("exposures_s") ? replay.numbers("exposures_s", exposure_s, 1, max_views)
                                           : std::vector<double>{replay.number("exposures_s", exposure_s)};
  if (times.size() != 1 && times.size() != per_view && times.size() != paths.size())
    replay.fail("exposures_s", fmt::format("expected 1 number, {} (one per frame of a view) or {} (one per file), got {}", per_view,
                                           paths.size(), times.size()));

  std::vector<double> angles;
  std::vector<int> lights;
  if (plan && plan->has("exposures_ms")) plan->fail("exposures_ms", "photographs state their times in replay.exposures_s");
  for (const char* key : {"reference_every", "dark_frames"})
    if (plan && plan->has(key)) plan->fail(key, "only where frames are taken; of photographs it is not known when they were");
  for (const char* key : {"adaptive", "adaptive_loss"})
    if (plan && plan->has(key)) plan->fail(key, "only where frames are taken");
  if (plan && plan->has("angles_deg")) angles = read_angles(*plan);
  if (plan && plan->has("lights")) lights = read_light_choice(*plan, rig.geometry);
  if (angles.size() > 1 && angles.size() != n_views)
    plan->fail("angles_deg", fmt::format("expected 1 angle or {} (one per view), got {}", n_views, angles.size()));
  if (lights.size() > 1 && lights.size() != n_views)
    plan->fail("lights", fmt::format("expected 1 light or {} (one per view), got {}", n_views, lights.size()));
  const std::size_t n_lights = rig.geometry.lights.size();
  if (lights.empty() && n_lights != 1 && n_lights != n_views)
    replay.fail("files", fmt::format("{} views with {} lights; expected one light per view, or plan.lights to say which", n_views, n_lights));

  for (std::size_t v = 0; v < n_views; ++v) {
    PlannedView view{of_view(angles, v, 0.0), of_view(lights, v, n_lights == 1 ? 0 : static_cast<int>(v)), {}, {}};
    std::vector<std::size_t> order(per_view);
    std::iota(order.begin(), order.end(), v * per_view);
    const auto time = [&](std::size_t i) { return times.size() == 1 ? times[0] : times[times.size() == per_view ? i % per_view : i]; };
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return time(a) < time(b); });
    for (const std::size_t i : order) {
      view.exposures_s.push_back(time(i));
      view.files.push_back(paths[i]);
    }
    rig.plan.push_back(std::move(view));
  }
}

}  // namespace

void name_views(std::vector<PlannedView>& plan) {
  std::array<int, 3> n{};
  for (PlannedView& view : plan) {
    const auto kind = static_cast<std::size_t>(view.kind);
    view.id = fmt::format("{}{:03d}", "LRD"[kind], n[kind]++);
  }
}

void read_plan(const TomlTable& root, const RigFiles& files, RigDescription& rig) {
  const auto plan = root.table("plan", {"angles_deg", "exposures_ms", "lights", "reference_every", "dark_frames", "adaptive", "adaptive_loss"});
  if (const auto replay = replay_table(root)) {
    plan_replay(plan, *replay, files, rig);
  } else {
    if (!plan) root.fail("", "[plan]: missing; expected angles_deg and exposures_ms");
    plan_captures(*plan, rig);
    plan_references(*plan, rig);
    plan_darks(*plan, rig);
    read_adaptive(*plan, rig);
  }
  name_views(rig.plan);
}

void read_reference_patch(const TomlTable& root, RigDescription& rig) {
  const auto table = root.table("reference_patch", {"x_px", "y_px", "width_px", "height_px"});
  if (!table) return;
  if (rig.kind == RigDescription::Kind::replay)
    root.fail("reference_patch", "only where frames are taken; of photographs it is not known when they were");
  const auto is_reference = [](const PlannedView& view) { return view.kind == ViewKind::reference; };
  if (std::any_of(rig.plan.begin(), rig.plan.end(), is_reference))
    root.fail("reference_patch", "expected this or plan.reference_every, not both: each says on its own what the lights do");
  const CameraModel& camera = rig.geometry.camera;
  const auto size = [&](const char* key, int largest) { return static_cast<int>(table->integer(key, 1, largest)); };
  PixelRectangle patch{0, 0, size("width_px", camera.width), size("height_px", camera.height)};
  patch.x = static_cast<int>(table->integer("x_px", 0, camera.width - patch.width));
  patch.y = static_cast<int>(table->integer("y_px", 0, camera.height - patch.height));
  for (const int y : {patch.y, patch.y + patch.height / 2, patch.y + patch.height - 1})
    for (const int x : {patch.x, patch.x + patch.width / 2, patch.x + patch.width - 1})
      if (trace(rig.geometry, {x, y}))
        root.fail("reference_patch", fmt::format("pixel ({}, {}) shows the sphere; expected a patch beside it", x, y));
  rig.reference_patch = patch;
}

}  // namespace lacquer::acquire::detail
