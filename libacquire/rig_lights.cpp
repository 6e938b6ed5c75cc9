#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <glm/geometric.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "libacquire/rig_parsing.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::acquire::detail {

namespace {

constexpr std::size_t max_lights = 100000;

using Row = std::vector<double>;

Row parse_row(std::string_view line, const std::string& where) {
  Row row;
  for (std::size_t at = 0; (at = line.find_first_not_of(" \t\r", at)) != std::string_view::npos;) {
    const std::size_t end = std::min(line.find_first_of(" \t\r", at), line.size());
    double value = 0;
    const auto [stop, error] = std::from_chars(line.data() + at, line.data() + end, value);
    if (error != std::errc() || stop != line.data() + end || !std::isfinite(value) || row.size() == 3)
      throw Error(ErrorCode::file, fmt::format("{}: expected up to 3 numbers, got \"{}\"", where, line.substr(0, 60)));
    row.push_back(value);
    at = end;
  }
  return row;
}

/// Numbers separated by blanks, one light per line; empty lines and lines that begin with # do not count.
std::vector<Row> read_light_table(const std::filesystem::path& file, bool may_have_one_column) {
  const std::string text = brdf::read_text(file, 16u << 20);
  std::vector<Row> rows;
  std::size_t line_number = 0;
  for (std::size_t begin = 0; begin < text.size();) {
    const std::size_t end = std::min(text.find('\n', begin), text.size());
    const std::string_view line = std::string_view(text).substr(begin, end - begin);
    const std::string where = fmt::format("{}:{}", file.string(), ++line_number);
    begin = end + 1;
    if (line.find_first_not_of(" \t\r") == std::string_view::npos || line.starts_with('#')) continue;
    rows.push_back(parse_row(line, where));
    if (rows.back().size() != 3 && !(may_have_one_column && rows.back().size() == 1))
      throw Error(ErrorCode::file, fmt::format("{}: expected 3 numbers, got {}", where, rows.back().size()));
    if (rows.size() > max_lights) throw Error(ErrorCode::file, fmt::format("{}: more than {} lights", file.string(), max_lights));
  }
  if (rows.empty()) throw Error(ErrorCode::file, file.string() + ": no lights in it");
  return rows;
}

Light distant_light(std::string name, const glm::dvec3& direction) {
  Light light;
  light.name = std::move(name);
  light.distant = true;
  light.on_arm = false;
  light.direction = glm::normalize(direction);
  return light;
}

void read_light_tables(const TomlTable& replay, const RigFiles& files, RigDescription& rig) {
  const auto directions_file = referenced_file(replay, "light_directions_file", files, rig);
  const auto directions = read_light_table(directions_file, false);
  std::vector<Row> intensities(directions.size(), Row{1});
  if (replay.has("light_intensities_file")) {
    const auto file = referenced_file(replay, "light_intensities_file", files, rig);
    intensities = read_light_table(file, true);
    if (intensities.size() != directions.size())
      replay.fail("light_intensities_file", fmt::format("{} has {} lights; expected {} as in {}", file.string(), intensities.size(),
                                                        directions.size(), directions_file.string()));
  }
  for (std::size_t i = 0; i < directions.size(); ++i) {
    const glm::dvec3 direction(directions[i][0], directions[i][1], directions[i][2]);
    if (!(glm::length(direction) > 1e-9))
      replay.fail("light_directions_file", fmt::format("light {} (from 0) has no direction: {} {} {}", i, direction.x, direction.y, direction.z));
    Light light = distant_light(fmt::format("light {}", i), direction);
    const Row& row = intensities[i];
    light.intensity = row.size() == 1 ? glm::dvec3(row[0]) : glm::dvec3(row[0], row[1], row[2]);
    for (int c = 0; c < 3; ++c)
      if (!(light.intensity[c] > 0))
        replay.fail("light_intensities_file", fmt::format("light {} (from 0) has intensity {}; expected a number above 0", i, light.intensity[c]));
    rig.geometry.lights.push_back(light);
  }
}

Light read_light(const TomlTable& t, std::size_t index, const RigGeometry& geometry) {
  const Range mm = {-1e7, 1e7};
  Light light;
  light.name = t.string("name", fmt::format("light {}", index));
  light.on_arm = t.boolean("on_arm", true);
  light.intensity = t.per_channel("intensity", Range::above(0), glm::dvec3(1.0));
  light.distant = t.has("direction");
  if (light.distant) {
    for (const char* key : {"position_mm", "diameter_mm", "falloff_exponent"})
      if (t.has(key)) t.fail(key, "a light with a direction is far away and has none");
    const glm::dvec3 direction = t.vector3("direction", mm);
    if (!(glm::length(direction) > 1e-9)) t.fail("direction", "expected a direction, got zero length");
    light.direction = glm::normalize(direction);
    return light;
  }
  if (!t.has("position_mm")) t.fail("position_mm", "missing; expected 3 numbers (or direction, for a distant light)");
  light.position = t.vector3("position_mm", mm) * metres_per_mm;
  light.diameter = t.number("diameter_mm", {0, 1e4}, 0) * metres_per_mm;
  light.falloff_exponent = t.number("falloff_exponent", {0, 1e4}, 0);
  if (!(glm::length(light.position) > geometry.sphere_radius + light.diameter / 2))
    t.fail("position_mm", fmt::format("lies inside the sphere of {} mm radius", geometry.sphere_radius / metres_per_mm));
  return light;
}

}  // namespace

void read_lights(const TomlTable& root, const RigFiles& files, RigDescription& rig) {
  const auto replay = replay_table(root);
  const auto tables = root.tables("lights", {"name", "position_mm", "direction", "intensity", "diameter_mm", "falloff_exponent", "on_arm"});
  if (replay && replay->has("light_directions_file")) {
    if (!tables.empty()) replay->fail("light_directions_file", "the lights are stated twice; [[lights]] are there already");
    read_light_tables(*replay, files, rig);
    return;
  }
  if (replay && replay->has("light_intensities_file")) replay->fail("light_intensities_file", "only with light_directions_file");
  if (tables.empty()) root.fail("", "[[lights]]: missing; expected at least one light");
  if (tables.size() > max_lights) root.fail("lights", fmt::format("expected at most {}, got {}", max_lights, tables.size()));
  for (const TomlTable& t : tables) {
    Light light = read_light(t, rig.geometry.lights.size(), rig.geometry);
    for (const Light& other : rig.geometry.lights)
      if (other.name == light.name) t.fail("name", fmt::format("\"{}\" is another light's name already", light.name));
    rig.geometry.lights.push_back(std::move(light));
  }
}

}  // namespace lacquer::acquire::detail
