#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

/// Counter-based random numbers: a number depends on a key and an index only, so frames are the same bytes for any number of threads
/// and in any order. Inline: a session of the paper draws some 4e9 of them.
namespace lacquer::acquire::sim {

/// Output function of SplitMix64 (Steele, Lea, Flood 2014): a bijection of 64 bits that mixes well.
inline std::uint64_t mix64(std::uint64_t z) {
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return z ^ (z >> 31);
}

/// Key of a sub-stream: order matters, combine(combine(seed, a), b).
inline std::uint64_t combine(std::uint64_t key, std::uint64_t value) { return mix64(key ^ mix64(value + 0x9e3779b97f4a7c15u)); }

/// Number `index` of the SplitMix64 sequence that starts at `key`, as a uniform number strictly inside (0, 1), 52 bits.
inline double uniform(std::uint64_t key, std::uint64_t index) {
  const std::uint64_t z = mix64(key + (index + 1) * 0x9e3779b97f4a7c15u);
  return (static_cast<double>(z >> 12) + 0.5) * 0x1p-52;
}

/// Ziggurat of 128 layers of equal area under exp(-x^2 / 2): Marsaglia and Tsang 2000, in the exact form of Doornik 2005 (ZIGNOR), which
/// takes layer and position from different bits.
struct Ziggurat {
  static constexpr int n_layers = 128;
  static constexpr double tail = 3.442619855899;       ///< where the lowest layer ends and the tail begins
  static constexpr double area = 9.91256303526217e-3;  ///< of each layer
  std::array<double, n_layers + 1> x;                  ///< right ends, falling
  std::array<double, n_layers> sure;                   ///< fraction of each layer that lies wholly under the curve

  Ziggurat() {
    double f = std::exp(-0.5 * tail * tail);
    x[0] = area / f;
    x[1] = tail;
    x[n_layers] = 0;
    for (std::size_t i = 2; i < n_layers; ++i) {
      x[i] = std::sqrt(-2 * std::log(area / x[i - 1] + f));
      f = std::exp(-0.5 * x[i] * x[i]);
    }
    for (std::size_t i = 0; i < n_layers; ++i) sure[i] = x[i + 1] / x[i];
  }
};
inline const Ziggurat ziggurat;

/// The 1.2 % of the numbers that fall outside a layer's sure part; further random numbers follow from `z` itself.
double normal_slow(std::uint64_t z);

/// Standard normal number of key and index, exact to double precision.
inline double normal(std::uint64_t key, std::uint64_t index) {
  const std::uint64_t z = mix64(key + (index + 1) * 0x9e3779b97f4a7c15u);
  const std::size_t layer = z & (Ziggurat::n_layers - 1);
  const double u = (static_cast<double>(z >> 12) + 0.5) * 0x1p-51 - 1;  // (-1, 1)
  if (std::abs(u) < ziggurat.sure[layer]) return u * ziggurat.x[layer];
  return normal_slow(z);
}

/// Quantile of the Poisson distribution by summing probabilities from 0: exact, for means up to some 30.
inline int poisson_quantile(double mean, double u) {
  if (u <= 1 - mean) return 0;  // exp(-mean) >= 1 - mean: most pixels of a dark background end here
  double probability = std::exp(-mean), cumulative = probability;
  int k = 0;
  while (u > cumulative && k < 400) {
    ++k;
    probability *= mean / k;
    cumulative += probability;
  }
  return k;
}

}  // namespace lacquer::acquire::sim
