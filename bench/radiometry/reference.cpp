#include "bench/radiometry/reference.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lacquer::bench {

namespace {

/// Known sensor as the loop needs it.
struct Known {
  std::vector<double> exposure;       ///< per raw value
  double read_variance, shot;         ///< linearised DN^2, DN
  double floor;                       ///< linearised DN at which rounding starts to give the lowest value of a sensor without black level
  bool linear;

  explicit Known(const Sensor& s)
      : exposure(s.response().curves[0].exposure),
        read_variance(std::pow(s.read_noise_e / s.noise().gain_e_per_dn, 2)),
        shot(1 / s.noise().gain_e_per_dn),
        floor(s.black_dn > 0 ? -std::numeric_limits<double>::infinity() : (exposure[0] + exposure[1]) / 2),
        linear(s.curve.linear) {}

  double variance(double z) const {
    double slope = 1;
    if (!linear) {
      const auto above = std::lower_bound(exposure.begin() + 1, exposure.end() - 1, z);
      slope = *above - *(above - 1);
    }
    return read_variance + shot * std::max(z, 0.0) + slope * slope / 12;
  }
};

}  // namespace

ReferenceImage merge_reference(const Stack& stack, std::span<const double> pilot) {
  const Known known(stack.sensor);
  const std::uint16_t top = static_cast<std::uint16_t>((1 << stack.sensor.bits) - 1);
  ReferenceImage image;
  image.radiance.resize(stack.truth.size());
  image.variance.resize(stack.truth.size());
  for (std::size_t i = 0; i < stack.truth.size(); ++i) {
    double x0 = 0;
    if (pilot.empty()) {
      double light = 0, time = 0;
      for (const auto& f : stack.frames)
        if (f.data[i] < top) light += known.exposure[f.data[i]], time += f.actual.exposure_s;
      x0 = time > 0 ? std::max(light / time, 0.0) : std::numeric_limits<double>::infinity();
    } else {
      x0 = pilot[i];
    }
    double precision = 0, weighted = 0;
    for (const auto& f : stack.frames) {
      const double t = f.actual.exposure_s, z = x0 * t;
      if (f.data[i] >= top) continue;
      const double variance = known.variance(z), low = z - 3 * std::sqrt(variance);
      if (low < known.floor) continue;
      precision += t * t / variance;
      weighted += t / variance * known.exposure[f.data[i]];
    }
    image.radiance[i] = precision > 0 ? weighted / precision : 0;
    image.variance[i] = precision > 0 ? 1 / precision : std::numeric_limits<double>::infinity();
  }
  return image;
}

}  // namespace lacquer::bench
