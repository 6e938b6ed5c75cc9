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

}  // namespace

RawFrame Camera::capture(const CaptureSettings& asked) {
  if (!(std::isfinite(asked.exposure_s) && asked.exposure_s > 0))
    throw Error(ErrorCode::usage, fmt::format("{}: exposure {} s: expected a finite time > 0", description(), asked.exposure_s));
  if (!std::isfinite(asked.gain_db))
    throw Error(ErrorCode::usage, fmt::format("{}: gain {} dB: expected a finite number", description(), asked.gain_db));
  RawFrame frame = do_capture(asked);
  if (const std::string defect = defect_of(frame); !defect.empty())
    throw Error(ErrorCode::device, fmt::format("{}: the camera returned an impossible frame: {}", description(), defect));
  return frame;
}

double Turntable::move_to(double angle) {
  if (!std::isfinite(angle))
    throw Error(ErrorCode::usage, fmt::format("{}: angle {}: expected a finite number of radians", description(), angle));
  const double read_back = do_move_to(angle);
  if (!std::isfinite(read_back))
    throw Error(ErrorCode::device, fmt::format("{}: angle read back as {} after a move to {} rad", description(), read_back, angle));
  return read_back;
}

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
  return *this;
}

Rig::~Rig() { make_safe(); }

}  // namespace lacquer::acquire
