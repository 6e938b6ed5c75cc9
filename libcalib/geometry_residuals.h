#pragma once

#include <cstddef>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <optional>
#include <vector>

#include "libcalib/geometry_solver.h"
#include "libcalib/geometry_unknowns.h"
#include "libcalib/response_algebra.h"

namespace lacquer::calib {

/// Silhouette and highlights against a geometry: residuals, how noisy the data are, and which of them are in use.
/// Residuals over sigma: one per edge, two (uncorrelated) per highlight, then what else is known, then the priors. Those not in use are 0.
class GeometryResiduals {
 public:
  /// Keeps references to all four.
  GeometryResiduals(const GeometryUnknowns& unknowns, const std::vector<EdgePoint>& edges, const std::vector<Highlight>& highlights,
                    const GeometryEvidence& evidence);

  std::vector<double> at(const std::vector<double>& x) const;
  /// By unknown: derivative of every residual. Central differences; all functions are smooth and exact to rounding: error about 1e-9.
  std::vector<std::vector<double>> derivatives(const std::vector<double>& x) const;

  /// How noisy the data are, by medians, which outliers hardly move: the sigmas given say only what they are relative to each other. What
  /// highlights scatter more along their track than across is the turntable's. Residuals of neighbouring edges that agree count as fewer edges:
  /// a limb that is not lit as its model has it moves many of them together. All data are in use afterwards.
  void measure_noise(const std::vector<double>& x);
  /// Angle of the turntable that a highlight says together with the one read back, minus the latter, given the rest of the geometry.
  ViewAngle angle_of(const acquire::RigGeometry& geometry, double turntable_scale, std::size_t highlight) const;
  /// Leaves out what is further than 5 sigma away.
  void select_inliers(const std::vector<double>& x);

  /// Sum of the squares, with a Cauchy loss of scale `k` on each datum (a highlight is one datum of two residuals); k = 0: squares.
  /// `weight`: of each residual, for the next step.
  double cost(const std::vector<double>& residuals, double k, std::vector<double>& weight) const;

  std::size_t n_data() const { return edges_.size() + 2 * highlights_.size(); }  ///< residuals of edges and highlights
  const GeometryUnknowns& unknowns() const { return unknowns_; }
  const std::vector<EdgePoint>& edges() const { return edges_; }
  const std::vector<Highlight>& highlights() const { return highlights_; }
  const GeometryEvidence& evidence() const { return evidence_; }
  const std::vector<bool>& edge_used() const { return edge_used_; }
  const std::vector<bool>& highlight_used() const { return highlight_used_; }
  const glm::dvec2& side(std::size_t edge) const { return sides_[edge]; }  ///< of the silhouette that an edge point is on, unit vector in the image
  double edge_factor() const { return edge_factor_; }
  double highlight_factor() const { return highlight_factor_; }
  double angle_sigma() const { return angle_sigma_; }  ///< of the turntable's angles, radians

  /// Observed minus predicted pixel of a highlight.
  static glm::dvec2 miss(const acquire::RigGeometry& geometry, double turntable_scale, const Highlight& highlight);

 private:
  double edge_residual(const acquire::RigGeometry& g, const std::vector<double>& x, std::size_t i) const;
  void evidence_residuals(const acquire::RigGeometry& g, const std::vector<double>& x, std::vector<double>& out) const;
  glm::dvec2 highlight_residual(const acquire::RigGeometry& g, double scale, std::size_t i) const;
  glm::dvec2 whole_residual(const acquire::RigGeometry& g, double scale, std::size_t i) const;  ///< used or not, along the track too

  const GeometryUnknowns& unknowns_;
  const std::vector<EdgePoint>& edges_;
  const std::vector<Highlight>& highlights_;
  const GeometryEvidence& evidence_;
  std::vector<std::optional<glm::dvec3>> sights_;  ///< of the edges, for a lens that is not an unknown
  std::vector<glm::dvec2> sides_;
  std::vector<bool> edge_used_, highlight_used_;
  double edge_factor_ = 1, highlight_factor_ = 1;
  double edge_shared_ = 1;         ///< part of edge_factor_ that neighbours agreeing is the cause of
  double angle_sigma_ = 0;         ///< found from the residuals along the highlights' tracks
  std::vector<glm::dvec2> track_;  ///< pixels per radian of the turntable, by highlight
};

/// J^T W J of columns of derivatives.
SymmetricMatrix normal_matrix(const std::vector<std::vector<double>>& columns, const std::vector<double>& weight);

}  // namespace lacquer::calib
