#pragma once

#include <array>
#include <cstddef>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <string>
#include <vector>

#include "libacquire/rig_geometry.h"
#include "libcalib/geometry_solver.h"

namespace lacquer::calib {

/// The unknowns of a geometry: corrections of the rig file's numbers, in units of their priors' sigmas (`x`, 0 = as the rig file has it).
class GeometryUnknowns {
 public:
  /// `seen`: by light, whether its place is an unknown. No light seen: neither axis, turntable nor lens are unknowns either.
  GeometryUnknowns(const acquire::RigGeometry& nominal, const GeometryPriors& priors, const std::vector<bool>& seen);

  const std::vector<GeometryParameter>& parameters() const { return parameters_; }
  std::size_t size() const { return parameters_.size(); }
  /// The light that unknown `k` moves, if it moves that one only.
  std::optional<std::size_t> light_of(std::size_t k) const;
  std::size_t first_of(std::size_t light) const { return first_light_[light]; }  ///< of the three unknowns of a light that is seen

  /// Of an edge point on the side `out` of the silhouette (unit vector in the image), pixels outwards.
  double edge_offset(const std::vector<double>& x, const glm::dvec2& out) const { return value(x, 3) + value(x, 4) * out.x + value(x, 5) * out.y; }
  double turntable_scale(const std::vector<double>& x) const { return has_lights() ? 1 + value(x, first_axis_ + 5) : 1; }
  acquire::RigGeometry geometry(const std::vector<double>& x) const;

  /// What images can see of `x`, whose geometry is `g`: as x, but the lights' places are those with the zero angle in them (rig frame, minus
  /// the rig file's, over the priors' sigmas) and the zero angle is 0. A light turns the same by the zero angle as by its own place; in these coordinates that
  /// stays exact wherever something linear in them was linearised.
  std::vector<double> visible(const acquire::RigGeometry& g, const std::vector<double>& x) const;
  /// The geometry of `x` with coordinate `k` of visible() moved by `step` and the others held.
  acquire::RigGeometry with_visible_moved(const std::vector<double>& x, std::size_t k, double step) const;

  /// Unknowns that are intrinsics of the camera: the first of them, and how many.
  std::size_t first_lens() const { return first_lens_; }
  std::size_t n_lens() const { return lens_.size(); }

  /// Appends the residuals of the priors, over sigma: size() numbers, those of a light behind the others'. A light's errors are those of a
  /// ruler (light_m) and of the arm's length, which is along its place; the lens' have its covariance.
  void prior_residuals(const std::vector<double>& x, std::vector<double>& out) const;

 private:
  void add_lens();
  void add(std::string name, std::string unit, double nominal, double sigma) {
    parameters_.push_back({std::move(name), std::move(unit), nominal, 0, 0, sigma, 0});
  }
  bool has_lights() const { return first_axis_ > 0; }
  double value(const std::vector<double>& x, std::size_t k) const { return x[k] * parameters_[k].prior_sigma; }

  acquire::RigGeometry nominal_;
  GeometryPriors priors_;
  std::vector<bool> seen_;
  std::array<glm::dvec3, 2> across_;  ///< unit, across the nominal axis; for the axis y: x and z
  std::vector<GeometryParameter> parameters_;
  std::vector<std::size_t> lens_;           ///< intrinsics that are unknowns, numbered fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6
  std::vector<double> lens_factor_;         ///< Cholesky factor of their correlations, lens_.size() squared
  std::size_t first_lens_ = 0;
  std::size_t first_axis_ = 0;              ///< index of the axis' six unknowns; 0: there are none
  std::vector<std::size_t> first_light_;    ///< by light: index of its three unknowns, if seen
};

}  // namespace lacquer::calib
