#include <fmt/format.h>

#include <cmath>
#include <string_view>

#include "libacquire/rig_parsing.h"

namespace lacquer::acquire::detail {

namespace {

constexpr Range degrees = {-36000, 36000};

void read_camera_device(const TomlTable& t, RigDescription& rig) {
  DevicesDescription& devices = rig.devices;
  CameraDeviceSettings& c = devices.camera;
  devices.camera_back_end = t.string("back_end");
  c.width = rig.geometry.camera.width;
  c.height = rig.geometry.camera.height;
  c.layout = rig.sensor.layout;
  c.bits = rig.sensor.bits;
  c.id = t.string("id", "");
  c.pixel_format = t.string("pixel_format", "");
  if (t.has("offset_px")) {
    const auto offset = t.numbers("offset_px", {0, 65535}, 2, 2);
    for (const double o : offset)
      if (o != std::floor(o)) t.fail("offset_px", fmt::format("expected whole numbers, got {:g}", o));
    c.offset_x = static_cast<int>(offset[0]);
    c.offset_y = static_cast<int>(offset[1]);
  }
  if (t.has("gain")) c.gain = t.number("gain", {-1e6, 1e6});
  c.packet_size = static_cast<int>(t.integer("packet_size", 576, 16000, 1400));
  c.timeout_s = t.number("timeout_s", {0.1, 600}, c.timeout_s);
  if (t.has("fixed_exposure_ms")) c.fixed_exposure_s = t.number("fixed_exposure_ms", {1e-3, 1e7}) * 1e-3;
  c.settle_frames = static_cast<int>(t.integer("settle_frames", 0, 100, c.settle_frames));
}

void read_turntable_device(const TomlTable& t, RigDescription& rig) {
  TicSettings& s = rig.devices.turntable;
  rig.devices.turntable_back_end = t.string("back_end");
  s.serial = t.string("serial", "");
  s.full_steps_per_turn = static_cast<int>(t.integer("full_steps_per_turn", 1, 100000, s.full_steps_per_turn));
  s.microsteps = static_cast<int>(t.integer("microsteps", 1, 256, s.microsteps));
  s.gear_ratio = t.number("gear_ratio", {1e-3, 1e5}, s.gear_ratio);
  if (t.has("current_limit_ma")) s.current_limit_a = t.number("current_limit_ma", Range::above(0, 10000)) * 1e-3;
  s.reversed = t.boolean("reversed", s.reversed);
  s.max_speed = t.number("max_speed_deg_per_s", Range::above(0, 36000), 20) * radians_per_degree;
  s.max_acceleration = t.number("max_acceleration_deg_per_s2", Range::above(0, 360000), 20) * radians_per_degree;
  s.backlash = t.number("backlash_deg", {0, 90}, 0) * radians_per_degree;
  s.min_angle = t.number("min_deg", degrees, degrees.min) * radians_per_degree;
  s.max_angle = t.number("max_deg", degrees, degrees.max) * radians_per_degree;
  if (!(s.min_angle < s.max_angle)) t.fail("max_deg", "expected more than min_deg");
  s.home = static_cast<TicSettings::Home>(t.choice("home", {"here", "reverse", "forward"}, 0));
  if (s.home == TicSettings::Home::here && t.has("home_angle_deg")) t.fail("home_angle_deg", "only with home = \"reverse\" or \"forward\"");
  s.home_angle = t.number("home_angle_deg", degrees, 0) * radians_per_degree;
  s.home_timeout_s = t.number("home_timeout_s", {1, 3600}, s.home_timeout_s);
  s.settle_s = t.number("settle_ms", {0, 60000}, s.settle_s * 1e3) * 1e-3;
}

void read_lights_device(const TomlTable& t, RigDescription& rig) {
  GpioSettings& s = rig.devices.lights;
  rig.devices.lights_back_end = t.string("back_end");
  s.settle_s = t.number("settle_ms", {0, 600000}, s.settle_s * 1e3) * 1e-3;
  const std::string common_chip = t.string("chip", "");
  for (const TomlTable& line : t.tables("lines", {"chip", "line", "offset", "active_low"})) {
    GpioLightSettings light;
    light.chip = line.string("chip", common_chip);
    if (light.chip.empty()) line.fail("chip", "missing; expected the name, label or path of a GPIO chip, here or in devices.lights (`lacquer devices`)");
    light.line = line.string("line", "");
    if (light.line.empty() != line.has("offset")) line.fail("line", "expected either the line's name, or its number as offset");
    if (line.has("offset")) light.offset = static_cast<unsigned>(line.integer("offset", 0, 65535));
    light.active_low = line.boolean("active_low", false);
    s.lights.push_back(std::move(light));
  }
  if (s.lights.size() != rig.geometry.lights.size())
    t.fail("lines", fmt::format("expected one per light, {} in the order of [[lights]], got {}", rig.geometry.lights.size(), s.lights.size()));
}

}  // namespace

void read_devices(const TomlTable& root, RigDescription& rig) {
  const auto devices = root.table("devices", {"camera", "turntable", "lights"});
  const bool hardware = rig.kind == RigDescription::Kind::hardware;
  if (devices && !hardware) root.fail("devices", "only a rig of kind \"hardware\" has this table");
  if (!hardware) return;
  if (!devices) root.fail("", "[devices]: missing; a rig of kind \"hardware\" says there what drives camera, turntable and lights");
  const auto part = [&](const char* key, TomlTable::Keys known) {
    auto table = devices->table(key, known);
    if (!table) devices->fail("", fmt::format("[devices.{}]: missing", key));
    return *table;
  };
  read_camera_device(part("camera", {"back_end", "id", "pixel_format", "offset_px", "gain", "packet_size", "timeout_s", "fixed_exposure_ms", "settle_frames"}), rig);
  read_turntable_device(part("turntable", {"back_end", "serial", "full_steps_per_turn", "microsteps", "gear_ratio", "current_limit_ma", "reversed", "max_speed_deg_per_s",
                                           "max_acceleration_deg_per_s2", "backlash_deg", "min_deg", "max_deg", "home", "home_angle_deg", "home_timeout_s", "settle_ms"}),
                        rig);
  read_lights_device(part("lights", {"back_end", "settle_ms", "chip", "lines"}), rig);
}

}  // namespace lacquer::acquire::detail
