#pragma once

#include <cstddef>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <string>
#include <vector>

#include "libacquire/rig_geometry.h"
#include "libcalib/geometry_estimate.h"
#include "libcalib/geometry_projection.h"

/// Sphere, turntable axis and lights from silhouette and highlights together. docs/geometry.md has the equations.
namespace lacquer::calib {

/// A point of the sphere's silhouette.
struct EdgePoint {
  glm::dvec2 pixel;
  double sigma;  ///< across the silhouette, pixels
};

/// Centre of the mirror peak of one view.
struct Highlight {
  std::string view;        ///< "L012"
  std::size_t light = 0;
  double turntable_angle = 0;  ///< radians, read back
  glm::dvec2 pixel{0.0};
  double xx = 1, xy = 0, yy = 1;  ///< covariance, pixels^2
};

/// What else is known of the unknowns, as residuals that are linear in GeometryUnknowns::visible() of them: rows[k] . visible - offset[k], over sigma.
struct GeometryEvidence {
  struct View {
    std::size_t light = 0;
    double turntable_angle = 0;  ///< radians, read back
  };
  std::vector<View> views;                 ///< it comes from
  bool has_tracks = false;                 ///< it holds what highlights say along their tracks: their residuals have only what is across
  std::vector<std::vector<double>> rows;
  std::vector<double> offset;
};

/// What the rig file is good for, 1 sigma: a builder with a ruler.
struct GeometryPriors {
  double sphere_m = 0.003;           ///< each coordinate of the sphere's centre
  double axis_point_m = 0.003;       ///< each coordinate of the axis' place, across the axis
  double axis_tilt_rad = 0.0174533;  ///< about each of the two directions across the axis
  double zero_angle_rad = 0.0174533;
  double turntable_scale = 1e-3;     ///< relative error of the turntable's steps
  double light_m = 0.005;            ///< each coordinate of a light
  double arm = 0.02;                 ///< relative, of a light's distance from the origin; in addition to light_m
  double edge_offset_px = 0.1;       ///< common error of all edge points, across the silhouette
  double edge_side_px = 0.02;        ///< the same with the cosine and the sine of the side: a limb is lit from one side, and looks it
  /// Of the camera's fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6 or the first of them, row-major, as Calibration::lens_covariance; empty: the lens is believed.
  std::vector<double> lens_covariance = {};
  std::size_t n_intrinsics() const;  ///< that lens_covariance is of
  void validate() const;
};

struct GeometryEstimate {
  acquire::RigGeometry geometry;  ///< the zero angle is in the lights' places; origin = estimated centre of the sphere
  double turntable_scale = 1;     ///< true angle = this * angle read back
  GeometryUncertainty uncertainty;
  bool converged = false;
  std::size_t n_edges = 0, n_highlights = 0;  ///< used
  double edge_rms_px = 0, highlight_rms_px = 0;  ///< of those used; highlights: per coordinate
  /// By which the sigmas given were too small (> 1) or too large, as the residuals show; highlights: across their track. 1 where there are
  /// too few residuals to say.
  double edge_noise_factor = 1, highlight_noise_factor = 1;
  double angle_sigma_rad = 0;     ///< scatter of the turntable's angles that the highlights show along their track
  std::size_t n_edge_outliers = 0;
  struct Outlier {
    std::string view;
    std::size_t light;
    glm::dvec2 residual;  ///< observed minus predicted, pixels
  };
  std::vector<Outlier> outliers;  ///< highlights left out
  double centre_sigma_px = 0;     ///< of the sphere's centre in the image, larger axis
  double light_sigma_rad = 0;     ///< RMS over the highlights' views: direction of the light seen from the sphere's centre
  double half_vector_sigma_rad = 0;  ///< half vector against normal, RMS over views and lit pixels
  double distance_sigma = 0;      ///< relative, of the lights' distance, RMS
  std::vector<std::string> warnings;  ///< what the images do not determine, in words
};

/// By light: whether anything says something of its place, which is an unknown then.
std::vector<bool> lights_with_data(const acquire::RigGeometry& nominal, const std::vector<Highlight>& highlights, const GeometryEvidence& evidence);

/// Maximum of the posterior: least squares of all residuals over their sigmas and of the priors, outliers found with a Cauchy loss first
/// and then left out by name. The sigmas of the data are scaled to what the residuals show, see GeometryEstimate. `evidence` is of the
/// unknowns of lights_with_data. `start`: a former solution in units of the priors, if there is one; outliers are then judged by it. Throws Error{input}: orthographic camera, a distant light with a highlight, no data at all.
GeometryEstimate solve_geometry(const acquire::RigGeometry& nominal, const std::vector<EdgePoint>& edges,
                                const std::vector<Highlight>& highlights, const GeometryPriors& priors = {}, const GeometryEvidence& evidence = {},
                                const std::vector<double>& start = {});

}  // namespace lacquer::calib
