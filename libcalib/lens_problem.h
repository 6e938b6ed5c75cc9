#pragma once

#include <array>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <string>
#include <vector>

#include "libcalib/lens_boards.h"
#include "libcalib/response_algebra.h"

/// What mrcal solves, in our types; private to the lens calibration. lens_problem.cpp alone sees mrcal.
namespace lacquer::calib {

/// Camera from board: rotation vector (radians) and translation (metres), as mrcal's rt.
using BoardPose = std::array<double, 6>;

/// One camera at the origin and boards in front of it. A corner of board i at column x and row y stands at
/// (x, y) * square, lifted by warp[0] (1 - u^2) + warp[1] (1 - v^2) metres, u and v from -1 to 1 over the board.
struct LensProblem {
  std::string model;                   ///< mrcal's name
  int width = 0, height = 0;
  BoardShape board;
  std::vector<double> intrinsics;
  std::vector<BoardPose> poses;
  std::array<double, 2> warp{};
  std::vector<glm::dvec3> observed;    ///< boards x rows x columns: pixel x, y and weight; weight < 0: an outlier, left out
};

/// What is free.
struct LensFreedom {
  bool core = true;         ///< fx fy cx cy; held where a spline has the same freedom
  bool distortion = true;
  bool poses = true;
  bool warp = true;
  bool regularise = true;   ///< mrcal's weak pull of the distortion to 0
};

struct LensSolution {
  double rms_px = 0;               ///< of the distances of the corners that count
  std::size_t n_outliers = 0;
  std::vector<glm::dvec2> residuals;  ///< predicted minus observed, pixels, as `observed`; outliers 0
};

/// Improves the free parts of `problem` in place by mrcal_optimize. Throws Error{input} where mrcal gives up.
LensSolution solve_lens(LensProblem& problem, const LensFreedom& freedom);

/// The state at the solution and what the corners say of it. mrcal's own scaled units: sigma = scale * scaled sigma.
struct LensInformation {
  std::vector<double> scale;  ///< physical per scaled unit; order: intrinsics that are free, poses, warp
  SymmetricMatrix all;        ///< J'J of corners and regularisation
  SymmetricMatrix corners;    ///< J'J of the corners alone: how their noise enters
  std::size_t n_intrinsics = 0, first_intrinsic = 0, first_pose = 0;  ///< in the state; first_intrinsic: the first free one of `intrinsics`
};
LensInformation lens_information(const LensProblem& problem, const LensFreedom& freedom);

/// Pixels of points in the camera frame, any model.
std::vector<glm::dvec2> project(const std::string& model, const std::vector<double>& intrinsics, const std::vector<glm::dvec3>& p_cam);
/// Unit directions in the camera frame; NaN where the model cannot be inverted.
std::vector<glm::dvec3> unproject(const std::string& model, const std::vector<double>& intrinsics, const std::vector<glm::dvec2>& pixels);

/// Change of the pixel of a point that hangs on the boards, as their poses and the lens change: rows x and y over the scaled state.
/// mrcal's "mean-frames" method: the point is carried by each board and averaged. `at_infinity`: only rotations carry.
std::array<std::vector<double>, 2> pixel_gradient(const LensProblem& problem, const LensInformation& information, const glm::dvec3& p_cam, bool at_infinity);

/// Number of intrinsics of a model; 0: mrcal does not know it.
std::size_t n_intrinsics_of(const std::string& model);

}  // namespace lacquer::calib
