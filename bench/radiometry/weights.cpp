#include "bench/radiometry/weights.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "bench/radiometry/errors.h"
#include "bench/radiometry/stack.h"
#include "libcalib/merge_weights.h"

namespace lacquer::bench {

namespace {

constexpr double full_scale_dn = 4095;

WeightLoss loss_of(const std::string& name, const calib::NoiseModel& noise, int frames, double decades) {
  const auto times = exposure_times(1e-4, 1e-4 * std::pow(10, decades), frames);
  const double constant = std::pow(noise.read_noise_e / noise.gain_e_per_dn, 2) + 1.0 / 12;
  std::vector<calib::ExposureNoise> exposures;
  for (const double t : times) exposures.push_back({t, constant});
  const calib::MergeWeights weights(exposures, {}, noise, 2 * full_scale_dn / times.front());
  std::vector<double> losses;
  for (double x = 1 / noise.gain_e_per_dn / times.back(); x * times.front() < full_scale_dn; x *= std::pow(10, 0.025)) {
    const auto usable = static_cast<std::int32_t>(std::count_if(times.begin(), times.end(), [&](double t) { return x * t < full_scale_dn; }));
    const auto table = weights.table();
    const auto& a = table.at(0, usable, table.bin_of(static_cast<float>(x))).a;
    double variance = 0, information = 0;
    for (int j = 0; j < usable; ++j) {
      const double t = times[static_cast<std::size_t>(j)], z = x * t;
      const double var = constant + z / noise.gain_e_per_dn + std::pow(noise.relative_noise * z, 2);
      const auto basis = calib::time_basis(t);
      double w = 0;
      for (std::size_t k = 0; k < basis.size(); ++k) w += a[k] * basis[k];
      variance += w * w * var;
      information += t * t / var;
    }
    losses.push_back(std::sqrt(variance * information) - 1);
  }
  return {name, frames, decades, quantile(losses, 0.5), *std::max_element(losses.begin(), losses.end())};
}

}  // namespace

std::vector<WeightLoss> weight_losses() {
  struct Kind {
    const char* name;
    double read_noise_e, relative_noise;
  };
  std::vector<WeightLoss> losses;
  for (const Kind& k : {Kind{"read 4 e-", 4, 0}, Kind{"read 30 e-", 30, 0}, Kind{"read 4 e-, relative 1 %", 4, 0.01},
                        Kind{"read 4 e-, relative 4 %", 4, 0.04}})
    for (const auto& [frames, decades] : {std::pair{4, 2.0}, {16, 3.12}, {16, 6.0}, {64, 6.0}}) {
      calib::NoiseModel noise;
      noise.gain_e_per_dn = 2.5, noise.read_noise_e = k.read_noise_e, noise.relative_noise = k.relative_noise;
      losses.push_back(loss_of(k.name, noise, frames, decades));
    }
  return losses;
}

}  // namespace lacquer::bench
