#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "libacquire/rig_description.h"
#include "libacquire/rig_geometry.h"
#include "libacquire/session.h"
#include "libcalib/drift.h"
#include "libcalib/geometry_estimate.h"
#include "libcalib/merge.h"
#include "libcalib/response.h"
#include "libcalib/sensor_maps.h"

namespace lacquer::calib {

/// Everything between raw counts and f_r, with where each part came from ("rig file", "estimated from brackets", ...).
struct Calibration {
  Response response;
  std::string response_source;
  NoiseModel noise;
  std::string noise_source;
  SensorMaps maps;                    ///< empty: every value is as `noise` says
  std::filesystem::path maps_file;    ///< where they were read from; empty: none. calibration.json keeps the path, not the maps
  std::string dark_source;            ///< what the dark views of the session said, in words; empty: none were taken
  acquire::RigGeometry geometry;      ///< lens, sphere, turntable axis, lights
  std::string geometry_source;
  std::vector<double> lens_covariance;  ///< of fx fy cx cy and as much of the distortion as the lens model has, row-major; empty: not known
  double turntable_scale = 1;         ///< true angle = this * angle read back
  GeometryUncertainty geometry_uncertainty;  ///< empty: taken over from the rig file, not estimated
  glm::dvec3 dn_per_radiance{1.0};    ///< linearised DN per second of a radiance of 1 W m^-2 sr^-1, per channel
  bool absolute_scale = true;
  std::string scale_source;
  double scale_sigma = 0;             ///< relative standard error of the scale, common to all values; without what drifting lights add
  double vignetting = 0;              ///< as SensorDescription::vignetting
  double lens_blur_px = 0;            ///< sigma of the lens blur, pixels
  std::vector<LightDrift> light_drift;  ///< of each light of geometry; empty: the lights were not followed and count as steady
  std::string drift_source;           ///< by what they were followed, and what could not be; empty: they were not

  /// Intensity of a view's light relative to the one in `geometry`, which is that at the start. Its sigma is an error that all pixels of
  /// the view have in common. Throws Error{file} where the light drifts and the session does not say when the view was taken.
  DriftValue light_factor(const acquire::ViewRecord& view) const;
};

/// Takes all of it from the rig file: nominal geometry, linear response, noise and sensor maps from the files it names or else data-sheet
/// noise.
Calibration calibration_from_rig(const acquire::RigDescription& rig);

/// calibration.json
void write_calibration(const std::filesystem::path& file, const Calibration& calibration, const std::string& command_line);
Calibration read_calibration(const std::filesystem::path& file);

}  // namespace lacquer::calib
