#include "libacquire/rig_description.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <glm/geometric.hpp>

#include "libacquire/rig_parsing.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::acquire {

namespace fs = std::filesystem;

namespace detail {

namespace {

fs::path resolve(const fs::path& folder, const RigFiles& files, const std::string& as_written) {
  const auto copy = files.copied.find(as_written);
  return (copy == files.copied.end() ? folder / as_written : files.rig_folder / copy->second).lexically_normal();
}

}  // namespace

fs::path RigFiles::in_rig_folder(const std::string& as_written) const { return resolve(rig_folder, *this, as_written); }
fs::path RigFiles::in_data_folder(const std::string& as_written) const { return resolve(data_folder, *this, as_written); }

fs::path referenced_file(const TomlTable& table, const char* key, const RigFiles& files, RigDescription& rig) {
  const std::string as_written = table.string(key);
  const fs::path resolved = files.in_data_folder(as_written);
  std::error_code status;
  if (!fs::is_regular_file(resolved, status))
    table.fail(key, fmt::format("no file {}; paths are relative to {} (for photographs elsewhere: --data FOLDER)", resolved.string(),
                                files.data_folder.empty() ? "." : files.data_folder.string()));
  auto& known = rig.referenced_files;
  if (std::none_of(known.begin(), known.end(), [&](const ReferencedFile& f) { return f.as_written == as_written; }))
    known.push_back({as_written, resolved});
  return resolved;
}

std::optional<TomlTable> replay_table(const TomlTable& root) {
  return root.table("replay", {"folder", "files", "file_pattern", "first", "last", "exposures_s", "frames_per_view",
                               "light_directions_file", "light_intensities_file"});
}

}  // namespace detail

namespace {

using namespace detail;

/// Begins the part that with_copied_files() adds.
constexpr const char* copied_files_marker = "\n# Added by Lacquer: files that this rig refers to, as they lie beside this copy of it.\n";

TomlTable required_table(const TomlTable& root, const char* key, TomlTable::Keys known) {
  auto table = root.table(key, known);
  if (!table) root.fail("", fmt::format("[{}]: missing; every rig file has this table", key));
  return *table;
}

void read_kind(const TomlTable& root, RigDescription& rig) {
  const TomlTable table = required_table(root, "rig", {"name", "kind"});
  rig.name = table.string("name");
  using Kind = RigDescription::Kind;
  rig.kind = std::array{Kind::simulated, Kind::replay, Kind::hardware}[table.choice("kind", {"simulated", "replay", "hardware"})];
  const bool replay = rig.kind == RigDescription::Kind::replay;
  if (root.has("replay") && !replay) root.fail("replay", "only a rig of kind \"replay\" has this table");
  if (root.has("simulation") && rig.kind != Kind::simulated) root.fail("simulation", "only a rig of kind \"simulated\" has this table");
  if (!root.has("replay") && replay) root.fail("", "[replay]: missing; a rig of kind \"replay\" names its photographs there");
}

RigFiles locate_files(const TomlTable& root, const fs::path& file, const fs::path& data_folder) {
  RigFiles files;
  files.rig_folder = file.parent_path();
  for (auto& [as_written, copy] : root.string_table("copied_files")) {
    const fs::path path = fs::path(copy).lexically_normal();
    if (path.empty() || path.is_absolute() || *path.begin() == "..")
      root.fail("copied_files", fmt::format("\"{}\" is not a path inside the folder of the rig file", copy));
    files.copied[as_written] = copy;
  }
  files.data_folder = files.rig_folder;
  if (const auto replay = replay_table(root); replay && replay->has("folder")) files.data_folder /= replay->string("folder");
  if (!data_folder.empty()) files.data_folder = data_folder;
  return files;
}

void read_sensor(const TomlTable& root, const RigFiles& files, RigDescription& rig) {
  SensorDescription& s = rig.sensor;
  const bool simulated = rig.kind == RigDescription::Kind::simulated;
  const auto table = root.table("sensor", {"black_level_dn", "gain_e_per_dn", "read_noise_e", "full_well_e", "dark_current_e_per_s",
                                           "sensitivity_e_per_s", "vignetting", "lens_blur_px", "response", "gamma", "noise_file",
                                           "maps_file"});
  if (!table) {
    if (simulated) root.fail("", "[sensor]: missing; a simulated rig needs its sensitivity_e_per_s");
    return;
  }
  const TomlTable& t = *table;
  s.black_level_dn = t.number("black_level_dn", Range::at_least(0, (1 << s.bits) - 2), s.black_level_dn);
  s.gain_e_per_dn = t.number("gain_e_per_dn", Range::above(0), s.gain_e_per_dn);
  s.read_noise_e = t.number("read_noise_e", Range::at_least(0), s.read_noise_e);
  s.full_well_e = t.number("full_well_e", Range::at_least(0), s.full_well_e);
  s.dark_current_e_per_s = t.number("dark_current_e_per_s", Range::at_least(0), s.dark_current_e_per_s);
  if (simulated && !t.has("sensitivity_e_per_s")) t.number("sensitivity_e_per_s", Range::above(0, 1e15));  // says that it is missing
  s.sensitivity = t.per_channel("sensitivity_e_per_s", Range::above(0, 1e15), s.sensitivity);
  s.vignetting = t.number("vignetting", Range::at_least(0, 0.99), s.vignetting);
  s.lens_blur_px = t.number("lens_blur_px", {0, 100}, s.lens_blur_px);
  s.response = static_cast<SensorDescription::Response>(t.choice("response", {"linear", "gamma", "estimate"}, 0));
  const bool curved = s.response == SensorDescription::Response::gamma;
  if (t.has("gamma") && !curved) t.fail("gamma", "only with response = \"gamma\"");
  if (curved) s.gamma = t.number("gamma", {0.1, 10});
  if (t.has("noise_file")) s.noise_file = referenced_file(t, "noise_file", files, rig);
  if (t.has("maps_file")) s.maps_file = referenced_file(t, "maps_file", files, rig);
}

void read_mask(const TomlTable& root, const RigFiles& files, RigDescription& rig) {
  const auto table = root.table("mask", {"file", "min_y_mm"});
  if (!table) return;
  if (table->has("file")) rig.mask.file = referenced_file(*table, "file", files, rig);
  if (table->has("min_y_mm")) rig.mask.min_y = table->number("min_y_mm", {-1e6, 1e6}) * metres_per_mm;
}

void read_turntable(const TomlTable& root, RigDescription& rig) {
  const auto table = root.table("turntable", {"axis", "axis_point_mm"});
  if (!table) return;
  const glm::dvec3 axis = table->vector3("axis", {-1e6, 1e6}, {0, 1, 0});
  if (!(glm::length(axis) > 0)) table->fail("axis", "expected a direction, got zero length");
  rig.geometry.axis_direction = glm::normalize(axis);
  rig.geometry.axis_point = table->vector3("axis_point_mm", {-1e6, 1e6}, glm::dvec3(0.0)) * metres_per_mm;
}

void read_simulation(const TomlTable& root, const RigFiles& files, RigDescription& rig) {
  const auto table = root.table("simulation", {"paint", "seed", "axis_tilt_x_deg", "axis_tilt_z_deg", "axis_offset_mm",
                                               "step_error_rms_deg", "readback_noise_rms_deg", "led_drift_per_hour", "led_noise_rms",
                                               "stray_light", "blur_px", "sphere_offset_mm", "prnu", "dsnu_e", "dark_nonuniformity",
                                               "hot_pixels", "dead_pixels", "patch_radiance", "light_factor", "falloff_exponent"});
  if (!table) return;
  const TomlTable& t = *table;
  SimulationDescription& s = rig.simulation;
  if (t.has("paint")) s.paint = files.in_rig_folder(t.string("paint"));
  s.seed = static_cast<std::uint64_t>(t.integer("seed", 0, std::int64_t{1} << 53, 1));
  s.axis_tilt_x = t.number("axis_tilt_x_deg", {-45, 45}, 0) * radians_per_degree;
  s.axis_tilt_z = t.number("axis_tilt_z_deg", {-45, 45}, 0) * radians_per_degree;
  s.axis_offset = t.vector3("axis_offset_mm", {-1e3, 1e3}, glm::dvec3(0.0)) * metres_per_mm;
  s.step_error_rms = t.number("step_error_rms_deg", {0, 10}, 0) * radians_per_degree;
  s.readback_noise_rms = t.number("readback_noise_rms_deg", {0, 10}, 0) * radians_per_degree;
  s.led_drift_per_hour = t.number("led_drift_per_hour", {-0.9, 10}, 0);
  s.led_noise_rms = t.number("led_noise_rms", {0, 0.5}, 0);
  s.patch_radiance = t.number("patch_radiance", Range::at_least(0), 0);
  if (s.patch_radiance > 0 && !rig.reference_patch) t.fail("patch_radiance", "only with [reference_patch], which says where it is");
  s.stray_light = t.number("stray_light", {0, 1}, 0);
  s.blur_px = t.number("blur_px", {0, 50}, 0);
  s.sphere_offset = t.vector3("sphere_offset_mm", {-1e3, 1e3}, glm::dvec3(0.0)) * metres_per_mm;
  s.light_factor = t.per_channel("light_factor", Range::above(0, 1e6), s.light_factor);
  if (t.has("falloff_exponent")) s.falloff_exponent = t.number("falloff_exponent", {0, 1000});
  s.sensor.prnu = t.number("prnu", {0, 0.2}, 0);
  s.sensor.dsnu_e = t.number("dsnu_e", {0, 1e6}, 0);
  s.sensor.dark_nonuniformity = t.number("dark_nonuniformity", {0, 10}, 0);
  s.sensor.hot_pixels = t.number("hot_pixels", {0, 1}, 0);
  s.sensor.dead_pixels = t.number("dead_pixels", {0, 1}, 0);
}

}  // namespace

std::string name_of(ViewKind kind) { return std::array{"measurement", "reference", "dark"}[static_cast<std::size_t>(kind)]; }

RigDescription parse_rig(const std::string& text, const fs::path& file, const fs::path& data_folder) {
  const TomlTable root = TomlTable::parse(text, file.string(), {"rig", "camera", "sensor", "sphere", "mask", "turntable", "lights", "plan",
                                                                "simulation", "scale", "replay", "devices", "reference_patch", "guided", "copied_files"});
  RigDescription rig;
  rig.file = file;
  rig.text = text;
  read_kind(root, rig);
  const RigFiles files = locate_files(root, file, data_folder);
  read_camera(root, files, rig);
  read_sensor(root, files, rig);
  read_mask(root, files, rig);
  read_sphere_and_pose(root, rig);
  read_turntable(root, rig);
  read_lights(root, files, rig);
  read_plan(root, files, rig);
  read_reference_patch(root, rig);
  read_simulation(root, files, rig);
  read_devices(root, rig);
  read_guided(root, rig);
  if (const auto scale = root.table("scale", {"absolute"})) rig.absolute_scale = scale->boolean("absolute", true);
  return rig;
}

RigDescription read_rig(const fs::path& file, const fs::path& data_folder) {
  return parse_rig(brdf::read_text(file, 4u << 20), file, data_folder);
}

std::string with_copied_files(const std::string& text, const std::vector<std::pair<std::string, std::string>>& copies) {
  std::string result = text.substr(0, text.find(copied_files_marker));
  if (copies.empty()) return result;
  result += copied_files_marker;
  result += "[copied_files]\n";
  for (const auto& [as_written, copy] : copies) {
    const auto quoted = [](const std::string& s) {
      std::string q = "\"";
      for (const char c : s) {
        if (c == '"' || c == '\\') q += '\\';
        if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f)
          q += fmt::format("\\u{:04x}", static_cast<unsigned>(c));
        else
          q += c;
      }
      return q + "\"";
    };
    result += quoted(as_written) + " = " + quoted(copy) + "\n";
  }
  return result;
}

}  // namespace lacquer::acquire
