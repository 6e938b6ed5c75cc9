#pragma once

#include <glm/vec2.hpp>
#include <optional>
#include <string>
#include <vector>

#include "libacquire/frame.h"

namespace lacquer::calib {

/// A chessboard: its inner corners, and the side of its squares.
struct BoardShape {
  int columns = 0;      ///< inner corners along the longer side, as OpenCV and mrcal count them
  int rows = 0;
  double square_m = 0;  ///< metres
  std::size_t n_corners() const { return static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows); }
  void validate() const;  ///< Throws Error{usage}: 3 to 100 corners each way, a square of 1e-5 to 10 m
};

/// Corners of one photograph of a board, row by row of the board; pixel (0, 0) is a pixel's centre.
struct BoardView {
  std::string name;                 ///< of the photograph
  std::vector<glm::dvec2> corners;  ///< rows x columns
};

enum class CornerFinder { opencv, mrgingham };

/// Whether this build can do it.
bool has_mrgingham();

/// Inner corners of a chessboard, to a fraction of a pixel; nullopt: no whole board of this shape in the frame. A mosaic is turned into grey,
/// bits are stretched to the frame's own range. mrgingham finds square boards (columns = rows) only; Error{usage} otherwise.
std::optional<std::vector<glm::dvec2>> find_board(const acquire::RawFrame& frame, const BoardShape& shape, CornerFinder finder = CornerFinder::opencv);

}  // namespace lacquer::calib
