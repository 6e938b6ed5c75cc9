#include "libacquire/sim/simulated_world.h"

#include <fmt/format.h>

#include <bit>
#include <cmath>
#include <glm/geometric.hpp>

#include "libacquire/sim/noise.h"
#include "libacquire/sim/optics.h"
#include "libbrdf/error.h"

namespace lacquer::acquire::sim {

namespace {

/// Purposes of random numbers, so that no two share a stream.
enum Stream : std::uint64_t { step_error = 1, readback_error, led_noise, sensor_noise, sensor_flaws };

std::uint64_t key_of(double value) { return std::bit_cast<std::uint64_t>(value + 0.0); }  // + 0.0: -0 and 0 are one angle

void require(bool good, const char* field, const char* expected) {
  if (!good) throw Error(ErrorCode::input, fmt::format("simulated rig: {}: expected {}", field, expected));
}

void check_sensor(const SensorDescription& s) {
  require(s.bits >= 8 && s.bits <= 16, "sensor.bits", "8..16");
  require(s.gain_e_per_dn > 0 && std::isfinite(s.gain_e_per_dn), "sensor.gain_e_per_dn", "a number > 0");
  require(s.read_noise_e >= 0 && s.full_well_e >= 0 && s.dark_current_e_per_s >= 0, "sensor read noise, full well, dark current", "numbers >= 0");
  require(s.black_level_dn >= 0 && s.black_level_dn < (1 << s.bits) - 1, "sensor.black_level_dn", "a number inside the range of the ADC");
  require(s.vignetting >= 0 && s.vignetting < 1, "sensor.vignetting", "a number in [0, 1)");
  require(s.gamma > 0 && std::isfinite(s.gamma), "sensor.gamma", "a number > 0");
  for (int c = 0; c < 3; ++c) require(s.sensitivity[c] >= 0 && std::isfinite(s.sensitivity[c]), "sensor.sensitivity", "numbers >= 0");
}

void check_geometry(const RigGeometry& g) {
  const CameraModel& c = g.camera;
  require(c.width > 0 && c.height > 0 && c.width <= 32768 && c.height <= 32768, "camera size", "1..32768 pixels each way");
  require(c.focal.x > 0 && c.focal.y > 0, "camera.focal", "numbers > 0");
  require(g.sphere_radius > 0, "sphere radius", "a number > 0");
  require(!g.lights.empty(), "lights", "at least one");
  for (const Light& light : g.lights) {
    require(light.distant || glm::length(light.position) > g.sphere_radius, "lights: position", "a place outside the sphere");
    require(light.diameter >= 0, "lights: diameter", "a number >= 0");
  }
}

/// Checks in time: members that are made from the description come after.
const RigDescription& checked(const RigDescription& description, const std::shared_ptr<const brdf::Brdf>& paint) {
  require(paint != nullptr, "paint", "a BRDF to photograph (name one in the rig file or on the command line)");
  check_geometry(description.geometry);
  check_sensor(description.sensor);
  const SimulationDescription& s = description.simulation;
  require(s.blur_px >= 0 && s.blur_px <= 10, "simulation.blur_px", "a number in [0, 10]");
  require(s.patch_radiance >= 0 && std::isfinite(s.patch_radiance), "simulation.patch_radiance", "a number >= 0");
  require(s.stray_light >= 0 && std::isfinite(s.stray_light), "simulation.stray_light", "a number >= 0");
  require(s.step_error_rms >= 0 && s.readback_noise_rms >= 0 && s.led_noise_rms >= 0, "simulation noises", "numbers >= 0");
  const SensorFlaws& f = s.sensor;
  require(f.prnu >= 0 && f.dsnu_e >= 0 && f.dark_nonuniformity >= 0, "simulation.prnu, dsnu_e, dark_nonuniformity", "numbers >= 0");
  require(f.hot_pixels >= 0 && f.hot_pixels <= 1 && f.dead_pixels >= 0 && f.dead_pixels <= 1, "simulation.hot_pixels, dead_pixels",
          "numbers in [0, 1]");
  require(s.led_drift_per_hour < 1 && std::isfinite(s.led_drift_per_hour), "simulation.led_drift_per_hour", "a number < 1");
  return description;
}

glm::dvec3 tilted(const glm::dvec3& axis, double about_x, double about_z) {
  const double cx = std::cos(about_x), sx = std::sin(about_x), cz = std::cos(about_z), sz = std::sin(about_z);
  const glm::dvec3 a(axis.x, cx * axis.y - sx * axis.z, sx * axis.y + cx * axis.z);
  return {cz * a.x - sz * a.y, sz * a.x + cz * a.y, a.z};
}

/// A small white surface that each light lights alike, wherever the turntable stands.
void draw_patch(RadianceImage& image, const std::optional<PixelRectangle>& patch, double radiance) {
  if (!patch || radiance == 0) return;
  for (int channel = 0; channel < image.n_channels; ++channel)
    for (int y = patch->y; y < patch->y + patch->height; ++y)
      for (int x = patch->x; x < patch->x + patch->width; ++x) image.at(channel, x, y) = static_cast<float>(radiance);
}

}  // namespace

RigGeometry true_geometry(const RigDescription& description) {
  const SimulationDescription& s = description.simulation;
  RigGeometry g = description.geometry;
  g.axis_direction = tilted(g.axis_direction, s.axis_tilt_x, s.axis_tilt_z);
  g.axis_point += s.axis_offset - s.sphere_offset;
  g.cam_from_rig.translation += g.cam_from_rig.rotation * s.sphere_offset;
  for (Light& light : g.lights) {
    light.intensity *= s.light_factor;
    if (light.distant) continue;
    light.position -= s.sphere_offset;
    light.falloff_exponent = s.falloff_exponent.value_or(light.falloff_exponent);
  }
  return g;
}

SimulatedWorld::SimulatedWorld(const RigDescription& description, std::shared_ptr<const brdf::Brdf> paint)
    : description_(checked(description, paint)),
      geometry_(true_geometry(description)),
      renderer_(geometry_, std::move(paint), n_channels(description.sensor.layout)),
      sensor_(description.sensor, geometry_.camera.width, geometry_.camera.height, description.simulation.sensor,
              combine(description.simulation.seed, sensor_flaws)),
      dark_(geometry_.camera.width, geometry_.camera.height, n_channels(description.sensor.layout)) {
  move_to(0);
  time_ = 0;
  plan_times();
}

void SimulatedWorld::plan_times() {
  double time = 0, angle = 0;
  for (const PlannedView& view : description_.plan) {
    if (view.turntable_angle != angle)
      time += SimulatedTiming::per_move + SimulatedTiming::per_radian * std::abs(view.turntable_angle - angle);
    angle = view.turntable_angle;
    time += SimulatedTiming::per_switch;
    for (const double exposure : view.exposures_s) {
      planned_times_[{view.light, view.turntable_angle, exposure, 0.0}].push_back(time);
      time += exposure + SimulatedTiming::per_frame;
    }
  }
}

double SimulatedWorld::move_to(double angle) {
  if (angle != angle_) time_ += SimulatedTiming::per_move + SimulatedTiming::per_radian * std::abs(angle - angle_);
  const SimulationDescription& s = description_.simulation;
  angle_ = angle;
  true_angle_ = angle + s.step_error_rms * normal(combine(s.seed, step_error), key_of(angle));
  return angle + s.readback_noise_rms * normal(combine(s.seed, readback_error), key_of(angle));
}

void SimulatedWorld::switch_light(std::optional<int> light) {
  if (light == light_) return;
  light_ = light;
  time_ += SimulatedTiming::per_switch;
}

double SimulatedWorld::led_factor(double time) const {
  return 1 - description_.simulation.led_drift_per_hour * (3600.0 / SimulatedTiming::warm_up) * -std::expm1(-time / SimulatedTiming::warm_up);
}

const RadianceImage& SimulatedWorld::image() {
  const std::pair<int, double> view{*light_, true_angle_};
  if (rendered_ == view) return image_;
  rendered_.reset();  // an exception below leaves no half-finished image behind
  image_ = renderer_.render(geometry_.place_light(static_cast<std::size_t>(*light_), true_angle_));
  draw_patch(image_, description_.reference_patch, description_.simulation.patch_radiance);
  blur(image_, description_.simulation.blur_px);
  add_stray_light(image_, description_.simulation.stray_light);
  vignette(image_, geometry_.camera, description_.sensor.vignetting);
  rendered_ = view;
  return image_;
}

RawFrame SimulatedWorld::photograph(const CaptureSettings& settings) {
  const SimulationDescription& s = description_.simulation;
  const int light = light_.value_or(-1);
  const Picture picture{light, angle_, settings.exposure_s, settings.gain_db};
  const std::uint64_t n_before = n_taken_[picture]++;
  if (const auto planned = planned_times_.find(picture); planned != planned_times_.end() && n_before < planned->second.size())
    time_ = planned->second[n_before];
  frame_time_ = time_;
  std::uint64_t key = combine(s.seed, static_cast<std::uint64_t>(light) + 1);
  for (const std::uint64_t part : {key_of(angle_), key_of(settings.exposure_s), key_of(settings.gain_db), n_before}) key = combine(key, part);

  double factor = 0;
  if (light_) factor = led_factor(time_ + 0.5 * settings.exposure_s) * std::max(1 + s.led_noise_rms * normal(combine(key, led_noise), 0), 0.0);
  RawFrame frame = sensor_.expose(light_ ? image() : dark_, factor, settings, combine(key, sensor_noise));
  time_ += settings.exposure_s + SimulatedTiming::per_frame;
  return frame;
}

}  // namespace lacquer::acquire::sim
