#pragma once

#include <cstddef>

#include "libbrdf/cook_torrance.h"

namespace lacquer::brdf {

/// HalfAngleCosines of many points, as a structure of arrays.
struct CosineArrays {
  const float *n_dot_i, *n_dot_o, *n_dot_h, *i_dot_h, *tan2_theta_h;
};

/// CookTorrance::value without a footprint at `n` points into out[0], out[1], out[2] (R, G, B), 1/sr. Vectorised; AVX2 is chosen at run
/// time and gives the same bytes as the baseline. Within 1e-5 of the value in double at the same (float) cosines, also where exp alone
/// would underflow, as long as the result itself is a normal float; smaller ones may become 0. Both cosines must be > 1e-4.
void evaluate(const CookTorrance& model, const CosineArrays& cosines, std::size_t n, float* const out[3]);

/// false: the baseline's loop even where AVX2 is there; for tests that compare the two.
void use_vector_evaluation(bool yes);

}  // namespace lacquer::brdf
