#pragma once

namespace lacquer::fit {

/// How one value is compared with the model: as CellSet::Channel holds it.
struct Comparison {
  float target = 1, inverse_sigma = 0;
};

/// Of a measured value, 1/sr, and its variance. `signal`: what is believed to be the true value; `model_sigma`: relative.
Comparison comparison(double mean, double variance, double signal, double model_sigma);

/// Of a lower bound, which is kept or not, whatever the model says of its noise.
Comparison comparison_with_bound(double bound, double variance, double model_sigma);

}  // namespace lacquer::fit
