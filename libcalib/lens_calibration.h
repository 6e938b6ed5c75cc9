#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "libacquire/lens_file.h"
#include "libacquire/lens_residuals.h"
#include "libcalib/lens_boards.h"

/// A lens from photographs of a chessboard, solved by mrcal. docs/lens.md has the equations.
namespace lacquer::calib {

struct LensOptions {
  std::string model = "LENSMODEL_OPENCV8";  ///< any of mrcal's that it can solve for: OPENCV4, OPENCV5, OPENCV8, OPENCV12, SPLINED_STEREOGRAPHIC_...
  bool warp = true;               ///< solve for the board's bend, a parabola along each side
  bool reject_outliers = true;    ///< corners further off than 4 sigma, as mrcal does, again and again until none is left
  double focal_px = 0;            ///< first guess; 0: from the boards
  bool cross_validate = true;     ///< two more solutions, from every other board
  void validate() const;          ///< Throws Error{usage}.
};

/// 1 sigma of the pixel of a fixed point in the direction where it is largest, over a grid of pixels, in pixels.
struct PixelUncertainty {
  double centre = 0, mean = 0, worst = 0;
};

/// The lens of one half of the boards against that of the other.
struct LensCrossValidation {
  std::size_t n_boards[2] = {0, 0};
  double held_out_rms_px = 0;   ///< corners of each half seen through the other half's lens, only the boards' poses fitted: rms distance
  double fitted_rms_px = 0;     ///< the same through their own half's lens
  double difference_rms_px = 0; ///< of the two lenses' pixels of distant points over the image, the best rotation between them removed
  double expected_rms_px = 0;   ///< of that difference if both were as uncertain as they say
  double worst_difference_px = 0;
};

struct LensBoard {
  std::string name;
  double rms_px = 0;            ///< of the distances of its corners that count
  std::size_t n_outliers = 0;
  std::array<double, 6> pose{}; ///< camera from board: rotation vector, translation in metres
};

struct LensCalibration {
  acquire::Lens lens;           ///< with covariance, unless it is a spline
  std::array<double, 2> warp_m{}, warp_sigma_m{};  ///< lift of the board's middle along each side, metres
  std::vector<LensBoard> boards;
  std::vector<acquire::CornerResidual> residuals;  ///< of the corners that count, board by board
  std::size_t n_corners = 0, n_outliers = 0;
  double rms_px = 0;            ///< of the distances of the corners that count, as OpenCV states it; mrcal counts each coordinate, its number is smaller by sqrt(2)
  double sigma_px = 0;          ///< of one coordinate of a corner, from the residuals and degrees of freedom
  double board_distance_m = 0;  ///< mean of the boards' middles
  PixelUncertainty at_boards, at_infinity;
  double covered = 0;           ///< part of the image that corners came from (of 10 x 10 fields)
  std::optional<LensCrossValidation> cross;
  acquire::OptimizationInputs inputs;  ///< for the file
  std::vector<std::string> warnings;
};

/// All views are of one board in images of the same size. Throws Error{input}, one line, for fewer than 4 boards, boards that all stand alike,
/// and boards that fix no lens.
LensCalibration calibrate_lens(const std::vector<BoardView>& views, const BoardShape& board, int width, int height, const LensOptions& options);

}  // namespace lacquer::calib
