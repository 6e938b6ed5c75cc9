#pragma once

#include <array>
#include <glm/vec3.hpp>
#include <vector>

#include "libcalib/geometry_unknowns.h"

/// Lines of sight of the paint's samples through a lens whose intrinsics are unknowns. Internal to paint_evidence.cpp.
namespace lacquer::calib {

class PaintLens {
 public:
  static constexpr std::size_t max_unknowns = 12;
  /// At `x`; samples were taken through the lens as the rig file has it.
  PaintLens(const GeometryUnknowns& unknowns, const std::vector<double>& x);
  bool known() const { return up_.empty(); }
  std::size_t first() const { return first_; }
  std::size_t size() const { return up_.size(); }

  /// The line of sight (camera frame, unit) of the same pixel as the lens is now.
  glm::dvec3 moved(const glm::dvec3& sight) const;
  /// By unknown from first() on: rotation vector, camera frame, by which the line of sight of a fixed pixel turns.
  std::array<glm::dvec3, max_unknowns> turns(const glm::dvec3& sight) const;

 private:
  acquire::CameraModel before_, now_;
  std::size_t first_;
  std::vector<acquire::CameraModel> up_, down_;
};

}  // namespace lacquer::calib
