#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "libbrdf/files.h"
#include "libbrdf/table_accumulator.h"
#include "libfit/fit.h"
#include "test_support.h"

namespace lacquer::fit {
namespace {

using Grid = brdf::TableGrid;

TEST(Discretisation, SamplesScatteredOverTheCellsGiveTheClearCoatsMBecauseTheFitKnowsTheirSpread) {
  const brdf::CookTorrance paint = brdf::read_model(test::source_dir() / "data-samples" / "paints" / "polaris-silber.json");
  std::mt19937_64 generator(1);
  std::uniform_real_distribution<double> uniform(0, 1);
  brdf::TableAccumulator accumulator(3);
  for (std::size_t i = 0; i < Grid::n_cells; i += 97) {
    const Grid::Cell cell = Grid::cell(i);
    const double low = Grid::theta_h_edge(cell.theta_h), high = Grid::theta_h_edge(cell.theta_h + 1);
    for (int k = 0; k < 4; ++k) {
      const brdf::HalfDiff c{low + (high - low) * uniform(generator), (cell.theta_d + uniform(generator)) * std::numbers::pi / 2 / Grid::n_theta_d,
                             (cell.phi_d + uniform(generator)) * std::numbers::pi / Grid::n_phi_d};
      const auto cosines = brdf::half_angle_cosines(c);
      if (std::min(cosines.n_dot_i, cosines.n_dot_o) < 0.0872) continue;
      const glm::dvec3 f = paint.value(cosines);
      for (std::size_t channel = 0; channel < 3; ++channel) accumulator.add(channel, c, f[static_cast<int>(channel)], 0, cosines.n_dot_i);
    }
  }
  brdf::HalfAngleTable table = accumulator.table(false);
  const double truth = paint.lobes.back().m;
  EXPECT_NEAR(fit_table(table, {.n_lobes = 3}).model.lobes.back().m / truth, 1, 0.002);
  for (auto& channel : table.channels) std::fill(channel.footprint_along.begin(), channel.footprint_along.end(), 0.0f);
  EXPECT_GT(fit_table(table, {.n_lobes = 3}).model.lobes.back().m / truth, 1.002);  // mean coordinates alone: too wide
}

}  // namespace
}  // namespace lacquer::fit
