#pragma once

#include <vector>

#include "libcalib/bracket_samples.h"
#include "libcalib/noise_model.h"
#include "libcalib/response.h"

namespace lacquer::calib {

/// Is the response the line v - black? Wald test of eight smooth deviations of ln exposure (Legendre polynomials over the levels that hold
/// data) per channel, estimated along with the black level and the errors of the exposure times, so that neither looks like a curve; their
/// covariance is that of the scatter from pixel to pixel and trusts no noise model. A channel is curved when the deviations are
/// significant (chi-square with 8 degrees of freedom, 1 % over all channels) AND larger than 0.05 % RMS: with enough pixels everything
/// becomes significant. `known`: black level and saturation. Internal to response.cpp.
LinearityTest test_linearity(const BracketSamples& samples, const NoiseModel& known);

}  // namespace lacquer::calib
