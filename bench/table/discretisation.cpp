#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <string>

#include "bench/table/parts.h"
#include "libbrdf/files.h"
#include "libbrdf/table_accumulator.h"
#include "libfit/fit.h"

/// What the cells' size does to the clear coat's m: noise-free samples of the paints, scattered over the cells, through table and fit.
namespace lacquer::bench {

namespace {

using Grid = brdf::TableGrid;

/// Up to four samples in every `step`-th cell, anywhere in it, weighted by the irradiance.
brdf::HalfAngleTable sampled(const brdf::CookTorrance& paint, std::size_t step) {
  std::mt19937_64 generator(1);
  std::uniform_real_distribution<double> uniform(0, 1);
  brdf::TableAccumulator accumulator(3);
  for (std::size_t i = 0; i < Grid::n_cells; i += step) {
    const Grid::Cell cell = Grid::cell(i);
    const double low = Grid::theta_h_edge(cell.theta_h), high = Grid::theta_h_edge(cell.theta_h + 1);
    for (int k = 0; k < 4; ++k) {
      const brdf::HalfDiff c{low + (high - low) * uniform(generator), (cell.theta_d + uniform(generator)) * std::acos(0.0) / Grid::n_theta_d,
                             (cell.phi_d + uniform(generator)) * std::acos(-1.0) / Grid::n_phi_d};
      const auto cosines = brdf::half_angle_cosines(c);
      if (std::min(cosines.n_dot_i, cosines.n_dot_o) < 0.0872) continue;
      const glm::dvec3 f = paint.value(cosines);
      for (std::size_t channel = 0; channel < 3; ++channel) accumulator.add(channel, c, f[static_cast<int>(channel)], 0, cosines.n_dot_i);
    }
  }
  return accumulator.table(false);
}

/// The narrowest lobe's m by the fit, against the truth.
double m_error(const brdf::HalfAngleTable& table, const brdf::CookTorrance& truth) {
  const auto narrowest = [](const brdf::CookTorrance& model) {
    double m = 1;
    for (const auto& lobe : model.lobes)
      if (lobe.ks.x + lobe.ks.y + lobe.ks.z > 0) m = std::min(m, lobe.m);
    return m;
  };
  int n_lobes = 0;  // 2K Acrylack has one that is off: a fit would spend it beside another
  for (const auto& lobe : truth.lobes) n_lobes += lobe.ks.x + lobe.ks.y + lobe.ks.z > 0;
  return narrowest(fit::fit_table(table, {.n_lobes = n_lobes}).model) / narrowest(truth) - 1;
}

}  // namespace

void discretisation(const std::filesystem::path& source, bool smoke) {
  fmt::print("m of the clear coat from noise-free samples, fit / truth - 1\n\n"
             "| paint | cells' centres | mean coordinates | mean coordinates and spread within the cell |\n|---|---|---|---|\n");
  for (const char* name : {"ford-f8", "polaris-silber", "opel-titan", "bmw-339", "2k-acrylack", "white", "blue", "blue-matte"}) {
    const brdf::CookTorrance paint = brdf::read_model(source / "data-samples" / "paints" / (std::string(name) + ".json"));
    brdf::HalfAngleTable table = sampled(paint, smoke ? 97 : 5);
    const double with_spread = m_error(table, paint);
    for (brdf::TableChannel& t : table.channels) std::fill(t.footprint_along.begin(), t.footprint_along.end(), 0.0f);
    const double with_means = m_error(table, paint);
    for (brdf::TableChannel& t : table.channels)
      for (std::size_t i = 0; i < Grid::n_cells; ++i) {
        if (t.origin[i] == brdf::CellOrigin::empty) continue;
        const brdf::HalfDiff centre = Grid::centre(i);
        t.theta_h[i] = static_cast<float>(centre.theta_h);
        t.theta_d[i] = static_cast<float>(centre.theta_d);
        t.phi_d[i] = static_cast<float>(centre.phi_d);
      }
    fmt::print("| {} | {:+.2f} % | {:+.3f} % | {:+.4f} % |\n", name, 100 * m_error(table, paint), 100 * with_means, 100 * with_spread);
    std::fflush(stdout);
    if (smoke) return;
  }
}

}  // namespace lacquer::bench
