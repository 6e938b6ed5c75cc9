#pragma once

#include "libcalib/lens_calibration.h"
#include "libcalib/lens_problem.h"

namespace lacquer::calib {

/// The "optimization_inputs" of a .cameramodel, with which mrcal's tools show residuals and uncertainties: the arguments of mrcal.optimize() in
/// Python as a NumPy .npz archive (uncompressed), in base 85 as Python's base64.b85encode writes it.
acquire::OptimizationInputs optimization_inputs(const LensProblem& solution, const LensFreedom& freedom, const std::vector<BoardView>& views);

}  // namespace lacquer::calib
