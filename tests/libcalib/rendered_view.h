#pragma once

#include <cstdint>
#include <glm/vec2.hpp>
#include <memory>
#include <utility>
#include <vector>

#include "libacquire/frame.h"
#include "libacquire/rig_description.h"
#include "libacquire/sim/optics.h"
#include "libacquire/sim/sensor_model.h"
#include "libacquire/sim/sphere_renderer.h"
#include "libbrdf/brdf.h"
#include "libcalib/calibration.h"
#include "libcalib/merge.h"

/// Views of a simulated rig as its camera and the merge give them, whole or of a window, with the truth known: for tests and benchmarks
/// of silhouette and highlights.
namespace lacquer::test {

/// The same rig whose camera has only the pixels of a window, `corner` in even numbers. Its own vignetting is that of a smaller camera.
inline acquire::RigDescription windowed(acquire::RigDescription rig, const glm::ivec2& corner, const glm::ivec2& size) {
  rig.geometry.camera.centre -= glm::dvec2(corner);
  rig.geometry.camera.width = size.x;
  rig.geometry.camera.height = size.y;
  return rig;
}

class RenderedRig {
 public:
  RenderedRig(acquire::RigDescription rig, std::shared_ptr<const brdf::Brdf> paint)
      : rig_(std::move(rig)),
        renderer_(rig_.geometry, std::move(paint), acquire::n_channels(rig_.sensor.layout)),
        sensor_(rig_.sensor, rig_.geometry.camera.width, rig_.geometry.camera.height),
        calibration_(calib::calibration_from_rig(rig_)) {}

  const acquire::RigDescription& rig() const { return rig_; }
  /// The truth.
  const calib::Calibration& calibration() const { return calibration_; }

  /// Light on the sensor.
  acquire::sim::RadianceImage render(std::size_t light, double angle) const {
    auto image = renderer_.render(rig_.geometry.place_light(light, angle));
    acquire::sim::blur(image, rig_.simulation.blur_px);
    acquire::sim::vignette(image, rig_.geometry.camera, rig_.sensor.vignetting);
    return image;
  }

  /// Its bracket, merged.
  calib::RadianceImage photograph(const acquire::sim::RadianceImage& light, const std::vector<double>& exposures_s, std::uint64_t seed) const {
    std::vector<acquire::RawFrame> frames;
    for (std::size_t k = 0; k < exposures_s.size(); ++k)
      frames.push_back(sensor_.expose(light, 1, {.exposure_s = exposures_s[k]}, seed * 1000 + k));
    return calib::merge_bracket(frames, calibration_.response, calibration_.noise);
  }

 private:
  acquire::RigDescription rig_;
  acquire::sim::SphereRenderer renderer_;
  acquire::sim::SensorModel sensor_;
  calib::Calibration calibration_;
};

}  // namespace lacquer::test
