#pragma once

#include <cmath>
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

/// Quantile of the standard normal distribution for u in (0, 1): Wichura 1988, algorithm AS 241, PPND7, about 7 digits.
inline double normal_quantile(double u) {
  const double q = u - 0.5;
  if (std::abs(q) <= 0.425) {
    const double r = 0.180625 - q * q;
    return q * (((59.109374720 * r + 159.29113202) * r + 50.434271938) * r + 3.3871327179) /
           (((67.187563600 * r + 78.757757664) * r + 17.895169469) * r + 1.0);
  }
  const double r = std::sqrt(-std::log(q < 0 ? u : 1 - u));
  double z;
  if (r <= 5) {
    const double s = r - 1.6;
    z = (((0.17023821103 * s + 1.3067284816) * s + 2.7568153900) * s + 1.4234372777) / ((0.12021132975 * s + 0.73700164250) * s + 1.0);
  } else {
    const double s = r - 5;
    z = (((0.017337203997 * s + 0.42868294337) * s + 3.0812263860) * s + 6.6579051150) / ((0.012258202635 * s + 0.24197894225) * s + 1.0);
  }
  return q < 0 ? -z : z;
}

inline double normal(std::uint64_t key, std::uint64_t index) { return normal_quantile(uniform(key, index)); }

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
