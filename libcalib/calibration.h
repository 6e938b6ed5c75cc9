#pragma once

#include <filesystem>
#include <string>

#include "libacquire/rig_description.h"
#include "libacquire/rig_geometry.h"
#include "libcalib/merge.h"
#include "libcalib/response.h"

namespace lacquer::calib {

/// Everything between raw counts and f_r, with where each part came from ("rig file", "estimated from brackets", ...).
struct Calibration {
  Response response;
  std::string response_source;
  NoiseModel noise;
  std::string noise_source;
  acquire::RigGeometry geometry;      ///< lens, sphere, turntable axis, lights
  std::string geometry_source;
  glm::dvec3 dn_per_radiance{1.0};    ///< linearised DN per second of a radiance of 1 W m^-2 sr^-1, per channel
  bool absolute_scale = true;
  std::string scale_source;
  double vignetting = 0;              ///< as SensorDescription::vignetting
  double lens_blur_px = 0;            ///< sigma of the lens blur, pixels
};

/// Takes all of it from the rig file: nominal geometry, data-sheet noise, linear response (or `response`, when given).
Calibration calibration_from_rig(const acquire::RigDescription& rig);

/// calibration.json
void write_calibration(const std::filesystem::path& file, const Calibration& calibration, const std::string& command_line);
Calibration read_calibration(const std::filesystem::path& file);

}  // namespace lacquer::calib
