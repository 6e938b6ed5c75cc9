#pragma once

#include "libcalib/lens_calibration.h"
#include "libcalib/lens_problem.h"

namespace lacquer::calib {

/// First guess, near enough for the solver: focal length by Zhang's closed form (OpenCV), poses by PnP, then mrcal's own solution of the lens
/// LENSMODEL_OPENCV4. Where that stays poor, from a row of focal lengths between a fisheye's and a telephoto's, the best is kept.
LensProblem seed_lens(const std::vector<BoardView>& views, const BoardShape& board, int width, int height, double focal_px);

}  // namespace lacquer::calib
