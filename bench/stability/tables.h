#pragma once

#include <cmath>
#include <filesystem>
#include <random>
#include <string>

#include "libbrdf/files.h"
#include "libbrdf/table.h"

/// Tables of models for the hard cases.
namespace lacquer::bench {

inline brdf::CookTorrance paint(const std::string& name) {
  return brdf::read_model(std::filesystem::path(LACQUER_SOURCE_DIR) / "data-samples" / "paints" / (name + ".json"));
}

inline brdf::CookTorrance one_lobe(double ks, double m, double r, const glm::dvec3& kd = glm::dvec3(0.02, 0.03, 0.04)) {
  return {kd, {{glm::dvec3(ks), m, r}}};
}

/// Puts one measured value into a cell, at its centre.
inline void set(brdf::TableChannel& t, std::size_t cell, double value, double sigma = 0) {
  const brdf::HalfDiff centre = brdf::TableGrid::centre(cell);
  t.mean[cell] = static_cast<float>(value);
  t.variance[cell] = static_cast<float>(sigma * sigma);
  t.theta_h[cell] = static_cast<float>(centre.theta_h);
  t.theta_d[cell] = static_cast<float>(centre.theta_d);
  t.phi_d[cell] = static_cast<float>(centre.phi_d);
  t.count[cell] = 1;
  t.origin[cell] = brdf::CellOrigin::measured;
}

/// Every n-th cell of a model for which `keep(cell)`, with relative noise.
template <typename Keep>
brdf::HalfAngleTable table_of(const brdf::CookTorrance& model, std::size_t every, double noise, const Keep& keep, unsigned seed = 1) {
  brdf::HalfAngleTable table(3);
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  for (std::size_t i = every / 2; i < brdf::TableGrid::n_cells; i += every) {
    const auto cosines = brdf::half_angle_cosines(brdf::TableGrid::centre(i));
    if (std::min(cosines.n_dot_i, cosines.n_dot_o) <= 0.01 || !keep(brdf::TableGrid::cell(i))) continue;
    const glm::dvec3 f = model.value(cosines);
    for (int c = 0; c < 3; ++c) set(table.channels[static_cast<std::size_t>(c)], i, f[c] * (1 + noise * normal(random)), noise * f[c]);
  }
  return table;
}

inline brdf::HalfAngleTable table_of(const brdf::CookTorrance& model, std::size_t every, double noise = 0, unsigned seed = 1) {
  return table_of(model, every, noise, [](const auto&) { return true; }, seed);
}

}  // namespace lacquer::bench
