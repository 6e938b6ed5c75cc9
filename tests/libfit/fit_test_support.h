#pragma once

#include <cmath>
#include <filesystem>
#include <random>
#include <string>
#include <vector>

#include "libbrdf/brdf.h"
#include "libbrdf/files.h"
#include "libbrdf/table.h"
#include "libfit/fit.h"
#include "test_support.h"

namespace lacquer::test {

inline const std::vector<std::string> paint_names{
    "ford-f8", "polaris-silber", "opel-titan", "bmw-339", "2k-acrylack", "white", "blue", "blue-matte"};

/// A paint of Günther et al. 2005, Table 1.
inline brdf::CookTorrance paint(const std::string& name) {
  return brdf::read_model(source_dir() / "data-samples" / "paints" / (name + ".json"));
}

inline brdf::CookTorrance diffuse(const glm::dvec3& kd) {
  brdf::CookTorrance model;
  model.kd = kd;
  return model;
}

/// Noise-free table of every n-th cell (a prime, so that every row of the grid keeps cells of all azimuths),
/// float values at cell centres. Quick, where brdf::tabulate_brdf takes a while for all 1.4 million cells.
inline brdf::HalfAngleTable table_of(const brdf::CookTorrance& model, std::size_t every = 7,
                                     std::size_t n_channels = 3) {
  brdf::HalfAngleTable table(n_channels);
  for (std::size_t i = every / 2; i < brdf::TableGrid::n_cells; i += every) {
    const auto centre = brdf::TableGrid::centre(i);
    const auto cosines = brdf::half_angle_cosines(centre);
    if (std::min(cosines.n_dot_i, cosines.n_dot_o) <= 0.01) continue;
    const glm::dvec3 f = model.value(cosines);
    for (std::size_t c = 0; c < n_channels; ++c) {
      brdf::TableChannel& t = table.channels[c];
      t.mean[i] = static_cast<float>(f[static_cast<int>(c)]);
      t.theta_h[i] = static_cast<float>(centre.theta_h);
      t.theta_d[i] = static_cast<float>(centre.theta_d);
      t.phi_d[i] = static_cast<float>(centre.phi_d);
      t.count[i] = 1;
      t.origin[i] = brdf::CellOrigin::measured;
    }
  }
  return table;
}

/// Parameters in the order of FitResult::parameters, three channels.
inline std::vector<double> parameter_values(const brdf::CookTorrance& model) {
  std::vector<double> values;
  for (int c = 0; c < 3; ++c) values.push_back(model.kd[c]);
  for (const auto& lobe : model.lobes)
    for (int c = 0; c < 3; ++c) values.push_back(lobe.ks[c]);
  for (const auto& lobe : model.lobes) values.insert(values.end(), {lobe.m, lobe.r});
  return values;
}

/// Gaussian noise, sigma = hypot(relative * value, floor), with its true variance in the table.
inline brdf::HalfAngleTable with_noise(brdf::HalfAngleTable table, double relative, double floor,
                                       unsigned seed) {
  std::mt19937_64 generator(seed);
  std::normal_distribution<double> normal;
  for (auto& channel : table.channels)
    for (std::size_t i = 0; i < channel.mean.size(); ++i) {
      if (channel.origin[i] != brdf::CellOrigin::measured) continue;
      const double sigma = std::hypot(relative * channel.mean[i], floor);
      channel.variance[i] = static_cast<float>(sigma * sigma);
      channel.mean[i] = static_cast<float>(channel.mean[i] + sigma * normal(generator));
    }
  return table;
}

/// Mean |ln(fit / truth)| over cells within 80 degrees of the normal.
inline double mean_abs_log(const brdf::CookTorrance& fit, const brdf::CookTorrance& truth) {
  double sum = 0;
  std::size_t n = 0;
  for (std::size_t i = 0; i < brdf::TableGrid::n_cells; i += 137) {
    if (!brdf::TableGrid::reachable(brdf::TableGrid::cell(i), std::cos(80.0 / 180 * 3.14159265358979)))
      continue;
    const auto cosines = brdf::half_angle_cosines(brdf::TableGrid::centre(i));
    const glm::dvec3 a = fit.log_value(cosines), b = truth.log_value(cosines);
    for (int c = 0; c < 3; ++c, ++n) sum += std::abs(a[c] - b[c]);
  }
  return sum / static_cast<double>(n);
}

}  // namespace lacquer::test
