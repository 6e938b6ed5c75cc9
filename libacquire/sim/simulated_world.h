#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <tuple>
#include <vector>

#include "libacquire/rig_description.h"
#include "libacquire/sim/sensor_model.h"
#include "libacquire/sim/sphere_renderer.h"
#include "libbrdf/brdf.h"

namespace lacquer::acquire::sim {

/// The true geometry: nominal geometry plus the imperfections of description.simulation. Its origin is the TRUE centre of the sphere, so
/// camera, lights and axis are moved against a displaced sphere. Lights keep their nominal places at turntable angle 0 (where the arm
/// was measured) and turn about the true axis; a near light is aimed at the sphere where it is.
RigGeometry true_geometry(const RigDescription& description);

/// How long things take, seconds: what the LEDs' warm-up sees.
struct SimulatedTiming {
  static constexpr double per_move = 0.5;        ///< start, stop and settling
  static constexpr double per_radian = 2.0;
  static constexpr double per_switch = 0.05;     ///< LED settling
  static constexpr double per_frame = 0.04;      ///< readout
  static constexpr double warm_up = 3600.0;      ///< time constant of the LEDs
};

/// The scene that the simulated camera, turntable and lights share. Used from one thread at a time.
///
/// A frame depends on the description, the paint, and on what it is a picture of: light, angle, exposure, gain, and how often exactly
/// this frame was taken before. It does not depend on the frames taken before it, so that a session that is resumed gives the same
/// frames as one that ran through. Frames of the plan are taken at the time they have in the plan; others whenever they are taken.
class SimulatedWorld {
 public:
  /// Throws Error{input} where a number is missing or out of range.
  SimulatedWorld(const RigDescription& description, std::shared_ptr<const brdf::Brdf> paint);

  /// Moves the table; the true angle is off by step_error_rms, the returned one by readback_noise_rms, each always the same for an angle.
  double move_to(double angle);
  void switch_light(std::optional<int> light);
  RawFrame photograph(const CaptureSettings& settings);
  /// Counts a frame as taken.
  void skip(int light, double angle, const CaptureSettings& settings) { ++n_taken_[{light, angle, settings.exposure_s, settings.gain_db}]; }

  const RigGeometry& geometry() const { return geometry_; }
  std::optional<int> light() const { return light_; }
  double true_angle() const { return true_angle_; }
  double time() const { return time_; }  ///< simulated seconds since the lights were first switched on
  double frame_time() const { return frame_time_; }  ///< when the exposure of the last frame began

  /// Factor on the light's intensity at `time`: 1 - d (1 - exp(-t / warm_up)) with d = led_drift_per_hour, the slope at the start.
  double led_factor(double time) const;

 private:
  void plan_times();
  const RadianceImage& image();

  RigDescription description_;
  RigGeometry geometry_;
  SphereRenderer renderer_;
  SensorModel sensor_;
  RadianceImage dark_;
  using Picture = std::tuple<int, double, double, double>;  // light (-1: none), asked angle, exposure, gain
  std::map<Picture, std::vector<double>> planned_times_;    // of each time it is taken
  std::map<Picture, std::uint64_t> n_taken_;
  std::optional<int> light_;
  double angle_ = 0, true_angle_ = 0;
  double time_ = 0, frame_time_ = 0;
  std::optional<std::pair<int, double>> rendered_;  // light and true angle of image_
  RadianceImage image_;
};

}  // namespace lacquer::acquire::sim
