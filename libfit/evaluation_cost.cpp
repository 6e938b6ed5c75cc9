#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <vector>

#include "libbrdf/cook_torrance_array.h"
#include "libfit/fit.h"

namespace lacquer::fit {

namespace {

/// Pairs of directions over the hemisphere, an eighth of them near the mirror direction.
std::array<std::vector<float>, 5> typical_cosines(std::size_t n) {
  std::array<std::vector<float>, 5> columns;
  for (std::size_t i = 0; i < n; ++i) {
    const double t = (static_cast<double>(i) + 0.5) / static_cast<double>(n);
    const double theta_h = (i % 8 == 0 ? 0.05 : 1.0) * t, theta_d = 0.5 * std::fmod(997 * t, 1.0), phi_d = 6.28 * std::fmod(389 * t, 1.0);
    const auto c = brdf::half_angle_cosines(brdf::HalfDiff{theta_h, theta_d, phi_d});
    const double values[] = {c.n_dot_i, c.n_dot_o, c.n_dot_h, c.i_dot_h, c.tan2_theta_h};
    for (std::size_t k = 0; k < 5; ++k) columns[k].push_back(static_cast<float>(values[k]));
  }
  return columns;
}

}  // namespace

void add_evaluation_costs(FitResult& fit) {
  constexpr std::size_t n = 4096;  // stays in the second-level cache
  constexpr int repeats = 15;
  const auto columns = typical_cosines(n);
  const brdf::CosineArrays cosines{columns[0].data(), columns[1].data(), columns[2].data(), columns[3].data(), columns[4].data()};
  std::array<std::vector<float>, 3> out;
  for (auto& channel : out) channel.resize(n);
  float* const to[3] = {out[0].data(), out[1].data(), out[2].data()};
  for (Candidate& candidate : fit.candidates) {
    double best = std::numeric_limits<double>::infinity();  // what disturbs a measurement makes it longer
    for (int k = 0; k < repeats; ++k) {
      const auto start = std::chrono::steady_clock::now();
      brdf::evaluate(candidate.model, cosines, n, to);
      best = std::min(best, std::chrono::duration<double, std::nano>(std::chrono::steady_clock::now() - start).count());
    }
    candidate.evaluation_ns = best / n;
  }
  for (Candidate& c : fit.candidates)
    c.pareto = std::none_of(fit.candidates.begin(), fit.candidates.end(), [&](const Candidate& other) {
      return other.evaluation_ns < c.evaluation_ns && other.mean_abs_log <= c.mean_abs_log;
    });
}

}  // namespace lacquer::fit
