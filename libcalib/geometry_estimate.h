#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

namespace lacquer::calib {

class JsonReader;

/// One number of the estimated geometry. All are CORRECTIONS of what the rig file says, 0 = as the rig file has it: metres, radians, or
/// pure numbers, in the rig frame of the rig file (camera pose as given there: that is the gauge).
struct GeometryParameter {
  std::string name;        ///< "sphere.x", "light LED.y", "axis.tilt_x", ...
  std::string unit;        ///< "m", "rad", "px" or "1"
  double nominal = 0;      ///< what the rig file says, for people
  double correction = 0;
  double sigma = 0;        ///< 1 sigma, from images and prior
  double prior_sigma = 0;  ///< of the correction, before any image was seen
  double paint_shift = 0;  ///< by which the light on the paint moved it, in its sigmas before that
};

/// Where the turntable stood in a view, as the highlight says it together with what was read back.
struct ViewAngle {
  std::string view;
  double correction = 0;  ///< radians: true angle = turntable_scale * angle read back + correction
  double sigma = 0;       ///< 1 sigma, the rest of the geometry given
};

/// What is known of an estimated geometry besides its values.
struct GeometryUncertainty {
  std::vector<GeometryParameter> parameters;  ///< empty: nothing was estimated
  std::vector<double> covariance;             ///< of the corrections, row-major, parameters.size() squared
  std::vector<ViewAngle> angles;              ///< of views with a highlight, where angles scatter more than they are known from it
  double angle_correction(const std::string& view) const;  ///< 0: none
};

nlohmann::ordered_json uncertainty_to_json(const GeometryUncertainty& uncertainty);
/// Throws Error{file}: not as many numbers as parameters ask for, or not symmetric.
GeometryUncertainty uncertainty_from_json(const JsonReader& j);

}  // namespace lacquer::calib
