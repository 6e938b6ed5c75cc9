#pragma once

#include "libcalib/lens_calibration.h"
#include "libcalib/lens_problem.h"

namespace lacquer::calib {

/// Every other board against the rest, both solved anew from the solution of all. `solution`: with its outliers marked.
LensCrossValidation cross_validate(const LensProblem& solution, const LensFreedom& freedom);

/// Rotation that brings the directions `from` closest to `to`, both unit vectors, in the least-squares sense; they are nearly alike.
glm::dmat3 closest_rotation(const std::vector<glm::dvec3>& from, const std::vector<glm::dvec3>& to);

/// Pixels in rows and columns over the whole image, its border included.
std::vector<glm::dvec2> pixel_grid(int width, int height);

/// Standard deviation of one coordinate of a corner: residuals over the degrees of freedom.
double corner_sigma(const LensProblem& problem, const LensFreedom& freedom, const LensSolution& solution);

}  // namespace lacquer::calib
