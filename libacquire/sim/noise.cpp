#include "libacquire/sim/noise.h"

namespace lacquer::acquire::sim {

double normal_slow(std::uint64_t z) {
  const std::uint64_t key = mix64(z);
  for (std::uint64_t n = 0;; ++n) {
    const std::size_t layer = z & (Ziggurat::n_layers - 1);
    const double u = (static_cast<double>(z >> 12) + 0.5) * 0x1p-51 - 1;
    const double x = u * ziggurat.x[layer];
    if (std::abs(u) < ziggurat.sure[layer]) return x;
    if (layer == 0) {  // Marsaglia 1964: exponential numbers accepted under the tail
      for (;; ++n) {
        const double beyond = -std::log(uniform(key, 3 * n + 1)) / Ziggurat::tail;
        if (-2 * std::log(uniform(key, 3 * n + 2)) >= beyond * beyond) return std::copysign(Ziggurat::tail + beyond, u);
      }
    }
    const double below = std::exp(-0.5 * (ziggurat.x[layer] * ziggurat.x[layer] - x * x));
    const double above = std::exp(-0.5 * (ziggurat.x[layer + 1] * ziggurat.x[layer + 1] - x * x));
    if (above + uniform(key, 3 * n + 1) * (below - above) < 1) return x;
    z = mix64(key + (3 * n + 4) * 0x9e3779b97f4a7c15u);  // number 3 n + 3 of this stream
  }
}

}  // namespace lacquer::acquire::sim
