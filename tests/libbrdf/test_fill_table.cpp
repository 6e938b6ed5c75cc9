#include "libbrdf/fill_table.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "libbrdf/error.h"
#include "libbrdf/folded_channel.h"
#include "table1_paints.h"

namespace lacquer::brdf {
namespace {

/// One channel of a paint in theta_h cells 0 to 29 and theta_d cells 0 to 29, of which `removed` cells and their mirror cells are missing.
template <typename Removed>
HalfAngleTable corner_table(const CookTorrance& paint, const Removed& removed) {
  HalfAngleTable table(1);
  TableChannel& t = table.channels[0];
  for (int h = 0; h < 30; ++h)
    for (int d = 0; d < 30; ++d)
      for (int p = 0; p < TableGrid::n_phi_d; ++p) {
        if (removed(h, d, FoldedChannel::fold(p))) continue;
        const std::size_t i = TableGrid::index(TableGrid::Cell{h, d, p});
        t.mean[i] = static_cast<float>(paint.value(half_angle_cosines(TableGrid::centre(i))).y);
        t.count[i] = 1;
        t.origin[i] = CellOrigin::measured;
      }
  return table;
}

bool at_random(int h, int d, int p) {
  std::mt19937 generator(static_cast<unsigned>((h * 90 + d) * 90 + p));
  return generator() % 10 < 3;
}

double relative_sigma(const TableChannel& t, const TableGrid::Cell& cell) {
  const std::size_t i = TableGrid::index(cell);
  EXPECT_EQ(t.origin[i], CellOrigin::filled);
  return std::sqrt(t.variance[i]) / t.mean[i];
}

TEST(FillTable, CellsTakenOutComeBackWithinTheirBoundsAndNothingElseChanges) {
  const CookTorrance paint = test::table1_paint("blue-matte");
  HalfAngleTable table = corner_table(paint, at_random);
  const TableChannel before = table.channels[0];
  const FillReport report = fill_holes(table).at(0);
  const TableChannel& t = table.channels[0];

  double sum = 0, sum_sigma = 0;
  int n = 0, held = 0;
  for (int h = 0; h < 30; ++h)
    for (int d = 0; d < 30; ++d)
      for (int p = 0; p < TableGrid::n_phi_d; ++p) {
        const TableGrid::Cell cell{h, d, p};
        const std::size_t i = TableGrid::index(cell);
        if (!at_random(h, d, FoldedChannel::fold(p))) {
          ASSERT_EQ(t.origin[i], CellOrigin::measured);
          ASSERT_EQ(t.mean[i], before.mean[i]);
          continue;
        }
        ASSERT_EQ(t.origin[i], CellOrigin::filled);
        ASSERT_EQ(t.mean[i], t.mean[TableGrid::mirror(i)]);
        const double error = std::abs(std::log(t.mean[i] / paint.value(half_angle_cosines(TableGrid::centre(i))).y));
        sum += error;
        ++n;
        sum_sigma += relative_sigma(t, cell);
        held += error <= 1.96 * relative_sigma(t, cell);
      }
  EXPECT_LT(sum / n, 1e-3);  // a neighbour's value would be off by some percent
  EXPECT_GT(static_cast<double>(held) / n, 0.9);
  EXPECT_LT(sum_sigma, 20 * sum);  // bounds that hold, but not because they are as wide as the sky
  EXPECT_GT(report.n_left, 100000u);  // far from all data nothing is made up
  EXPECT_EQ(t.origin[TableGrid::index(TableGrid::Cell{85, 5, 90})], CellOrigin::empty);
  // Beyond the last theta_d row the further away the less is known.
  const double near = relative_sigma(t, {10, 30, 40}), further = relative_sigma(t, {10, 33, 40}), far = relative_sigma(t, {10, 38, 40});
  EXPECT_LT(near, further);
  EXPECT_LT(further, far);
}

// V grooves shadow with a crease at phi_d = 90 deg. Where a wedge hides it, data on both sides look like those of a smooth paint with less in the middle.
TEST(FillTable, ACreaseHiddenInAWedgeLiesWithinTheBounds) {
  const CookTorrance paint = test::table1_paint("blue-matte");
  const auto in_wedge = [](int p) { return p >= 80; };  // folded: 80 to 99 deg
  const auto filled = [&](double per_degree) {
    HalfAngleTable table = corner_table(paint, [&](int, int, int p) { return in_wedge(p); });
    TableChannel& t = table.channels[0];
    for (std::size_t i = 0; i < TableGrid::n_cells; ++i)
      if (t.origin[i] == CellOrigin::measured) t.mean[i] *= static_cast<float>(std::exp(-per_degree * std::abs(TableGrid::cell(i).phi_d - 89.5)));
    fill_holes(table);
    struct {
      double held = 0, n = 0, sigma = 0;
    } result;
    for (int h = 10; h < 30; ++h)
      for (int d = 10; d < 30; ++d)
        for (int p = 86; p < 94; ++p) {
          const std::size_t i = TableGrid::index(TableGrid::Cell{h, d, p});
          if (t.origin[i] != CellOrigin::filled) continue;
          const double truth = paint.value(half_angle_cosines(TableGrid::centre(i))).y * std::exp(-per_degree * std::abs(p - 89.5));
          const double sigma = std::sqrt(t.variance[i]) / t.mean[i];
          result.held += std::abs(std::log(t.mean[i] / truth)) <= 1.96 * sigma;
          result.sigma += sigma;
          ++result.n;
        }
    result.held /= result.n, result.sigma /= result.n;
    return result;
  };
  const auto smooth = filled(0), crease = filled(0.01);
  EXPECT_GT(smooth.n, 3000);
  EXPECT_GT(crease.n, 3000);
  EXPECT_GT(smooth.held, 0.9);
  EXPECT_GT(crease.held, 0.8);
  EXPECT_LT(smooth.sigma, 0.3 * crease.sigma);  // the price is paid where there is a crease only
}

TEST(FillTable, AModelFillsWhatCannotBeInterpolatedAndABoundIsKept) {
  const CookTorrance paint = test::table1_paint("blue-matte");
  HalfAngleTable table = corner_table(paint, [](int, int, int) { return false; });
  TableChannel& t = table.channels[0];
  // Clipped cells: one whose bound the neighbours agree with, one whose bound they contradict, as the model does.
  const std::size_t low = TableGrid::index(TableGrid::Cell{10, 10, 10}), high = TableGrid::index(TableGrid::Cell{12, 12, 12});
  const std::size_t hidden_low = TableGrid::mirror(low), hidden_high = TableGrid::mirror(high);
  for (const std::size_t i : {low, hidden_low, high, hidden_high}) {
    t.mean[i] *= i == low || i == hidden_low ? 0.5f : 2.0f;
    t.origin[i] = CellOrigin::clipped;
  }
  const CookTorranceBrdf model(paint);
  const FillReport report = fill_holes(table, {.model = &model}).at(0);
  EXPECT_EQ(t.origin[low], CellOrigin::filled);
  EXPECT_NEAR(t.mean[low] / paint.value(half_angle_cosines(TableGrid::centre(low))).y, 1, 0.01);
  EXPECT_EQ(t.origin[high], CellOrigin::clipped);
  const std::size_t far = TableGrid::index(TableGrid::Cell{70, 5, 90});
  EXPECT_EQ(t.origin[far], CellOrigin::modelled);
  EXPECT_NEAR(t.mean[far] / model.value(directions(TableGrid::centre(far))).value().x, 1, 1e-6);  // the only channel: the model's first
  EXPECT_GT(report.n_modelled, 100000u);
  EXPECT_EQ(report.n_left, 2u);  // the two that would contradict their bounds
}

TEST(FillTable, OptionsOutOfRangeAreNamed) {
  HalfAngleTable table(1);
  EXPECT_THROW(fill_holes(table, {.max_sigma = 0}), Error);
  EXPECT_THROW(fill_holes(table, {.min_cosine = 1}), Error);
}

TEST(FillTable, AnEmptyTableStaysEmpty) {
  HalfAngleTable table(1);
  const FillReport report = fill_holes(table).at(0);
  EXPECT_EQ(report.n_filled, 0u);
  EXPECT_EQ(std::count(table.channels[0].origin.begin(), table.channels[0].origin.end(), CellOrigin::empty),
            static_cast<std::ptrdiff_t>(TableGrid::n_cells));
}

}  // namespace
}  // namespace lacquer::brdf
