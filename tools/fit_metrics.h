#pragma once

#include <string>

#include "libbrdf/brdf.h"
#include "libfit/fit.h"

namespace lacquer::tools {

/// How far sphere pictures under the installed light probe are apart, exposed for the first one, CIEDE2000; `n` 0: no probe is installed or
/// no pixel is defined in both. Where one says nothing the other stands in for it. `scale`: on b.
struct ProbeDifference {
  std::size_t n = 0;
  double mean = 0, p95 = 0;
};
ProbeDifference probe_difference(const brdf::Brdf& a, const brdf::Brdf& b, double scale = 1);

/// One line for people; empty: not known.
std::string to_text(const ProbeDifference& difference);

/// Sets fit.metrics: the model beside `input`, what it was fitted to. Left empty where the two have no direction in common.
void add_metrics(const brdf::Brdf& input, fit::FitResult& fit);

}  // namespace lacquer::tools
