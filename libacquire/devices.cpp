#include "libacquire/devices.h"

#include <fmt/format.h>

#include <cmath>

#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

/// What is wrong with a frame of a back end; empty: nothing.
std::string defect_of(const RawFrame& frame) {
  if (frame.width <= 0 || frame.height <= 0) return fmt::format("frame size {} x {}", frame.width, frame.height);
  if (frame.bits < 8 || frame.bits > 16) return fmt::format("{} bits per value, expected 8..16", frame.bits);
  const std::size_t expected =
      static_cast<std::size_t>(frame.width) * static_cast<std::size_t>(frame.height) * static_cast<std::size_t>(values_per_pixel(frame.layout));
  if (frame.data.size() != expected) return fmt::format("{} values, expected {}", frame.data.size(), expected);
  unsigned all_bits = 0;  // a value >= 2^bits exists exactly if one of them has a higher bit set
  for (const std::uint16_t value : frame.data) all_bits |= value;
  if (all_bits >> frame.bits) return fmt::format("a value beyond {} bits (is the data left-aligned?)", frame.bits);
  if (!(std::isfinite(frame.actual.exposure_s) && frame.actual.exposure_s > 0))
    return fmt::format("exposure time read back as {} s", frame.actual.exposure_s);
  if (!std::isfinite(frame.actual.gain_db)) return fmt::format("gain read back as {} dB", frame.actual.gain_db);
  return {};
}

/// A camera that took other settings than asked: its read-back value would be true, but the plan would not be carried out.
std::string disobedience_of(const CaptureSettings& actual, const CaptureSettings& asked) {
  const double exposure_error = std::abs(actual.exposure_s - asked.exposure_s);
  if (exposure_error > 0.1 * asked.exposure_s && exposure_error > 2e-4)
    return fmt::format("exposure time read back as {:g} s, asked were {:g} s", actual.exposure_s, asked.exposure_s);
  if (std::abs(actual.gain_db - asked.gain_db) > 1)
    return fmt::format("gain read back as {:g} dB, asked were {:g} dB", actual.gain_db, asked.gain_db);
  return {};
}

void check_limits(const CameraLimits& limits, const CaptureSettings& asked, const Camera& camera) {
  constexpr double rounding = 1 + 1e-9;  // limits and times have gone through microseconds and milliseconds
  if (asked.exposure_s * rounding < limits.min_exposure_s || asked.exposure_s > limits.max_exposure_s * rounding)
    throw Error(ErrorCode::usage, fmt::format("{}: exposure {:g} ms: the camera takes {:g} to {:g} ms; change plan.exposures_ms", camera.description(),
                                              asked.exposure_s * 1e3, limits.min_exposure_s * 1e3, limits.max_exposure_s * 1e3));
  if (asked.gain_db < limits.min_gain_db - 1e-9 || asked.gain_db > limits.max_gain_db + 1e-9)
    throw Error(ErrorCode::usage, fmt::format("{}: gain {:g} dB: the camera takes {:g} to {:g} dB", camera.description(), asked.gain_db,
                                              limits.min_gain_db, limits.max_gain_db));
}

}  // namespace

RawFrame Camera::capture(const CaptureSettings& asked) {
  if (!(std::isfinite(asked.exposure_s) && asked.exposure_s > 0))
    throw Error(ErrorCode::usage, fmt::format("{}: exposure {} s: expected a finite time > 0", description(), asked.exposure_s));
  if (!std::isfinite(asked.gain_db))
    throw Error(ErrorCode::usage, fmt::format("{}: gain {} dB: expected a finite number", description(), asked.gain_db));
  check_limits(limits(), asked, *this);
  RawFrame frame = do_capture(asked);
  std::string defect = defect_of(frame);
  if (defect.empty()) defect = disobedience_of(frame.actual, asked);
  if (!defect.empty())
    throw Error(ErrorCode::device, fmt::format("{}: the camera returned an impossible frame: {}", description(), defect));
  return frame;
}

double Turntable::move_to(double angle) {
  if (!std::isfinite(angle))
    throw Error(ErrorCode::usage, fmt::format("{}: angle {}: expected a finite number of radians", description(), angle));
  const TurntableLimits allowed = limits();
  constexpr double rounding = 1e-9;  // radians: angles have gone through degrees
  if (angle < allowed.min_angle - rounding || angle > allowed.max_angle + rounding) {
    constexpr double degrees = 180 / 3.14159265358979323846;
    throw Error(ErrorCode::usage, fmt::format("{}: angle {:g} deg: the table turns from {:g} to {:g} deg; change plan.angles_deg", description(),
                                              angle * degrees, allowed.min_angle * degrees, allowed.max_angle * degrees));
  }
  const double read_back = do_move_to(angle);
  if (!std::isfinite(read_back))
    throw Error(ErrorCode::device, fmt::format("{}: angle read back as {} after a move to {} rad", description(), read_back, angle));
  return read_back;
}

void Turntable::home() { do_home(); }

void LightSwitch::on(int index) {
  if (index < 0 || index >= n_lights())
    throw Error(ErrorCode::usage, fmt::format("{}: light {}: expected 0..{}", description(), index, n_lights() - 1));
  do_on(index);
}

void Rig::make_safe() noexcept {
  if (lights) lights->off();
  if (turntable) turntable->hold();
}

Rig& Rig::operator=(Rig&& other) noexcept {
  if (this == &other) return *this;
  make_safe();
  turntable = std::move(other.turntable);
  lights = std::move(other.lights);
  camera = std::move(other.camera);
  frame_exists = std::move(other.frame_exists);
  frame_time = std::move(other.frame_time);
  return *this;
}

Rig::~Rig() { make_safe(); }

}  // namespace lacquer::acquire
