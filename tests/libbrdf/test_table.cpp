#include "libbrdf/table.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <cmath>
#include <numbers>
#include <random>
#include <vector>

#include "libbrdf/error.h"
#include "libbrdf/table_accumulator.h"
#include "table1_paints.h"

namespace lacquer::brdf {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double degree = pi / 180;

TEST(TableGrid, EveryCellContainsItsCentreAndHasItsOwnIndex) {
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
    const TableGrid::Cell cell = TableGrid::cell(i);
    ASSERT_EQ(TableGrid::index(cell), i);
    ASSERT_EQ(TableGrid::index(TableGrid::centre(i)), i);
  }
}

TEST(TableGrid, PhiDRunsFastestThenThetaDThenThetaH) {
  EXPECT_EQ(TableGrid::n_cells, 1458000u);  // MERL: 90 * 90 * 180
  EXPECT_EQ(TableGrid::index(TableGrid::Cell{0, 0, 1}), 1u);
  EXPECT_EQ(TableGrid::index(TableGrid::Cell{0, 1, 0}), 180u);
  EXPECT_EQ(TableGrid::index(TableGrid::Cell{1, 0, 0}), 16200u);
  EXPECT_EQ(TableGrid::index(TableGrid::Cell{89, 89, 179}), 1457999u);
}

TEST(TableGrid, ThetaHEdgesAreThoseOfMerl) {
  // (i/90)^2 * 90 deg by hand.
  EXPECT_EQ(TableGrid::theta_h_edge(0), 0.0);
  EXPECT_NEAR(TableGrid::theta_h_edge(1) / degree, 0.0111111, 1e-7);
  EXPECT_NEAR(TableGrid::theta_h_edge(2) / degree, 0.0444444, 1e-7);
  EXPECT_NEAR(TableGrid::theta_h_edge(3) / degree, 0.1, 1e-14);
  EXPECT_NEAR(TableGrid::theta_h_edge(5) / degree, 0.2777778, 1e-7);
  EXPECT_NEAR(TableGrid::theta_h_edge(45) / degree, 22.5, 1e-13);
  EXPECT_DOUBLE_EQ(TableGrid::theta_h_edge(90), pi / 2);
}

TEST(TableGrid, CellsChangeAtTheEdges) {
  for (int i = 1; i < TableGrid::n_theta_h; ++i) {
    const double edge = TableGrid::theta_h_edge(i);
    EXPECT_EQ(TableGrid::cell(HalfDiff{edge * (1 - 1e-12), 0.1, 0.1}).theta_h, i - 1);
    EXPECT_EQ(TableGrid::cell(HalfDiff{edge * (1 + 1e-12), 0.1, 0.1}).theta_h, i);
  }
  EXPECT_EQ(TableGrid::cell(HalfDiff{0.1, 44.999999 * degree, 0.1}).theta_d, 44);
  EXPECT_EQ(TableGrid::cell(HalfDiff{0.1, 45.000001 * degree, 0.1}).theta_d, 45);
  EXPECT_EQ(TableGrid::cell(HalfDiff{0.1, 0.1, 90.999999 * degree}).phi_d, 90);
  EXPECT_EQ(TableGrid::cell(HalfDiff{0.1, 0.1, 91.000001 * degree}).phi_d, 91);
}

TEST(TableGrid, TheRangesEndsBelongToTheLastCells) {
  const TableGrid::Cell last = TableGrid::cell(HalfDiff{pi / 2, pi / 2, std::nextafter(pi, 0.0)});
  EXPECT_EQ(last.theta_h, 89);
  EXPECT_EQ(last.theta_d, 89);
  EXPECT_EQ(last.phi_d, 179);
}

TEST(TableGrid, ReciprocityFoldsPhiD) {
  for (const double phi_d : {0.3, 1.7, 3.0}) {
    const int expected = TableGrid::cell(HalfDiff{0.2, 0.4, phi_d}).phi_d;
    EXPECT_EQ(TableGrid::cell(HalfDiff{0.2, 0.4, phi_d - pi}).phi_d, expected);
    EXPECT_EQ(TableGrid::cell(HalfDiff{0.2, 0.4, phi_d + pi}).phi_d, expected);
  }
  EXPECT_EQ(TableGrid::cell(HalfDiff{0.2, 0.4, pi}).phi_d, 0);
}

TEST(TableGrid, ReachableMeansBothDirectionsAreAboveTheHorizon) {
  // phi_d near 0: theta_i = theta_h + theta_d, theta_o = |theta_h - theta_d|; phi_d near 90 deg: cos =
  // cos(theta_h) cos(theta_d) > 0.
  const TableGrid::Cell beyond = TableGrid::cell(HalfDiff{50 * degree, 60 * degree, 0.01});
  const TableGrid::Cell above = TableGrid::cell(HalfDiff{20 * degree, 60 * degree, 0.01});
  const TableGrid::Cell sideways = TableGrid::cell(HalfDiff{50 * degree, 60 * degree, 90.5 * degree});
  EXPECT_FALSE(TableGrid::reachable(beyond));
  EXPECT_TRUE(TableGrid::reachable(above));
  EXPECT_FALSE(TableGrid::reachable(above, std::cos(75 * degree)));
  EXPECT_TRUE(TableGrid::reachable(sideways));
}

TEST(TableAccumulator, MeanVarianceAndCoordinatesByHand) {
  TableAccumulator accumulator(1);
  const TableGrid::Cell cell{30, 40, 50};  // theta_h 10.00..10.68 deg, theta_d 40..41 deg, phi_d 50..51 deg
  accumulator.add(0, {10.2 * degree, 40.2 * degree, 50.1 * degree}, 2.0, 0.01, 1.0, {1e-4, 6e-4, 2e-4});
  accumulator.add(0, {10.4 * degree, 40.6 * degree, 50.5 * degree - pi}, 6.0, 0.04, 3.0, {5e-4, 2e-4, -4e-4});  // folded
  const auto table = accumulator.table(false);
  const auto& t = table.channels[0];
  const std::size_t i = TableGrid::index(cell);
  EXPECT_EQ(t.count[i], 2u);
  EXPECT_EQ(t.origin[i], CellOrigin::measured);
  EXPECT_FLOAT_EQ(t.mean[i], 5.0f);                          // (1 * 2 + 3 * 6) / 4
  EXPECT_FLOAT_EQ(t.variance[i], (0.01f + 9 * 0.04f) / 16);  // sum w^2 var / (sum w)^2
  EXPECT_NEAR(t.theta_h[i] / degree, 10.35, 1e-5);           // (10.2 + 3 * 10.4) / 4; stored as float
  EXPECT_NEAR(t.theta_d[i] / degree, 40.5, 1e-5);
  EXPECT_NEAR(t.phi_d[i] / degree, 50.4, 1e-5);
  // (1 * 1e-4 + 3 * 5e-4) / 4, and the variance of tan(theta_h): (1 * 3 / 16) (tan 10.4 deg - tan 10.2 deg)^2 = 2.438e-6
  EXPECT_NEAR(t.footprint_along[i], 4.0244e-4, 2e-8);
  EXPECT_FLOAT_EQ(t.footprint_across[i], 3e-4f);    // (1 * 6e-4 + 3 * 2e-4) / 4
  EXPECT_FLOAT_EQ(t.footprint_mixed[i], -2.5e-4f);  // (1 * 2e-4 - 3 * 4e-4) / 4
  EXPECT_EQ(std::count(t.origin.begin(), t.origin.end(), CellOrigin::empty),
            static_cast<std::ptrdiff_t>(TableGrid::n_cells) - 1);
}

TEST(TableAccumulator, NegativeValuesOfDarkPixelsStay) {
  TableAccumulator accumulator(1);
  accumulator.add(0, {0.3, 0.4, 0.5}, -0.5, 1.0, 1.0);
  accumulator.add(0, {0.3, 0.4, 0.5}, 0.1, 1.0, 1.0);
  EXPECT_FLOAT_EQ(accumulator.table(false).channels[0].mean[TableGrid::index(HalfDiff{0.3, 0.4, 0.5})],
                  -0.2f);
}

TEST(TableAccumulator, SymmetryFillsEmptyCellsOnlyAndSaysSo) {
  TableAccumulator accumulator(1);
  const HalfDiff alone{0.3, 0.4, 50.3 * degree}, mirrored{0.3, 0.4, 129.7 * degree};
  const HalfDiff left{0.3, 0.5, 20.5 * degree}, right{0.3, 0.5, 159.5 * degree};
  accumulator.add(0, alone, 2.0, 0.25, 1.0, {1e-4, 2e-4, 5e-5});
  accumulator.add(0, left, 3.0, 0.25, 1.0);
  accumulator.add(0, right, 4.0, 0.25, 1.0);
  const auto table = accumulator.table(true);
  const auto& t = table.channels[0];
  const std::size_t i = TableGrid::index(mirrored);
  EXPECT_EQ(t.origin[i], CellOrigin::symmetric);
  EXPECT_EQ(t.mean[i], 2.0f);
  EXPECT_EQ(t.variance[i], 0.25f);
  EXPECT_FLOAT_EQ(t.footprint_along[i], 1e-4f);
  EXPECT_EQ(t.footprint_across[i], 2e-4f);
  EXPECT_EQ(t.footprint_mixed[i], -5e-5f);  // seen in the mirror
  EXPECT_NEAR(t.phi_d[i] / degree, 129.7, 1e-5);
  EXPECT_EQ(t.origin[TableGrid::index(alone)], CellOrigin::measured);
  EXPECT_EQ(t.mean[TableGrid::index(left)], 3.0f);  // measured cells are not touched
  EXPECT_EQ(t.mean[TableGrid::index(right)], 4.0f);
  EXPECT_EQ(std::count(t.origin.begin(), t.origin.end(), CellOrigin::symmetric), 1);
}

TEST(TableAccumulator, ACellOfClippedSamplesAloneHoldsTheirMeanBound) {
  TableAccumulator accumulator(1);
  const std::size_t i = TableGrid::index(TableGrid::Cell{30, 40, 50});
  accumulator.add_bound(0, {10.2 * degree, 40.2 * degree, 50.1 * degree}, 2.0, 0.01, 1.0, {1e-4, 6e-4, 2e-4});
  accumulator.add_bound(0, {10.4 * degree, 40.6 * degree, 50.5 * degree}, 6.0, 0.04, 3.0, {5e-4, 2e-4, -4e-4});
  const auto t = accumulator.table(true).channels[0];
  EXPECT_EQ(t.origin[i], CellOrigin::clipped);
  EXPECT_EQ(t.count[i], 2u);
  EXPECT_FLOAT_EQ(t.mean[i], 5.0f);                          // as for values: (1 * 2 + 3 * 6) / 4
  EXPECT_FLOAT_EQ(t.variance[i], (0.01f + 9 * 0.04f) / 16);
  EXPECT_NEAR(t.theta_h[i] / degree, 10.35, 1e-5);
  EXPECT_NEAR(t.footprint_along[i], 4.0244e-4, 2e-8);
  // A bound is not passed on to the mirror cell.
  EXPECT_EQ(std::count(t.origin.begin(), t.origin.end(), CellOrigin::empty), static_cast<std::ptrdiff_t>(TableGrid::n_cells) - 1);
}

TEST(TableAccumulator, AnUnclippedSampleMakesACellMeasuredWhateverCameFirst) {
  const HalfDiff place{0.3, 0.4, 0.5};
  const std::size_t i = TableGrid::index(place);
  for (const bool bound_first : {true, false}) {
    TableAccumulator accumulator(1);
    if (bound_first) accumulator.add_bound(0, place, 9.0, 1.0, 5.0);
    accumulator.add(0, place, 2.0, 0.25, 1.0);
    if (!bound_first) accumulator.add_bound(0, place, 9.0, 1.0, 5.0);
    const auto t = accumulator.table(false).channels[0];
    EXPECT_EQ(t.origin[i], CellOrigin::measured);
    EXPECT_EQ(t.mean[i], 2.0f);
    EXPECT_EQ(t.variance[i], 0.25f);
    EXPECT_EQ(t.count[i], 1u);
  }
}

TEST(TableBrdf, AClippedCellIsAHoleForTheLookup) {
  HalfAngleTable table(1);
  const std::size_t i = TableGrid::index(TableGrid::Cell{20, 20, 20});
  table.channels[0].origin[i] = CellOrigin::clipped;
  table.channels[0].mean[i] = 1;
  EXPECT_FALSE(TableBrdf(table, "clipped").value(directions(TableGrid::centre(i))).has_value());
}

TEST(TableAccumulator, StoredPhiDStaysBelowPi) {
  TableAccumulator accumulator(1);
  const double just_below = pi - 1e-9;  // nearest float: 3.1415927 > pi
  accumulator.add(0, {0.3, 0.4, just_below}, 1.0, 0.0, 1.0);
  accumulator.add(0, {0.3, 0.5, 0.0}, 1.0, 0.0, 1.0);  // its mirror image would be pi
  const auto table = accumulator.table(true);
  const auto& t = table.channels[0];
  const std::size_t measured = TableGrid::index(HalfDiff{0.3, 0.4, just_below});
  const std::size_t mirror = TableGrid::index(TableGrid::Cell{
      TableGrid::cell(HalfDiff{0.3, 0.5, 0}).theta_h, TableGrid::cell(HalfDiff{0.3, 0.5, 0}).theta_d, 179});
  for (const std::size_t i : {measured, mirror}) {
    ASSERT_NE(t.origin[i], CellOrigin::empty);
    EXPECT_EQ(TableGrid::index(HalfDiff{t.theta_h[i], t.theta_d[i], t.phi_d[i]}), i);
  }
}

TEST(TableAccumulator, ADirectionBelowTheHorizonIsRefused) {
  TableAccumulator accumulator(1);
  EXPECT_THROW(accumulator.add(0, {80 * degree, 80 * degree, 0.01}, 1, 1, 1), Error);
}

TEST(ReachableCells, NumbersEveryReachableCellOnce) {
  const ReachableCells& cells = reachable_cells();
  std::vector<bool> taken(cells.size());
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
    const int row = static_cast<int>(i / TableGrid::n_phi_d), phi_d = static_cast<int>(i % TableGrid::n_phi_d);
    if (TableGrid::reachable(TableGrid::cell(i))) {
      ASSERT_TRUE(cells.contains(row, phi_d)) << i;
    }
    if (!cells.contains(row, phi_d)) continue;
    ASSERT_LT(cells.slot(row, phi_d), cells.size());
    ASSERT_FALSE(taken[cells.slot(row, phi_d)]);
    taken[cells.slot(row, phi_d)] = true;
  }
  EXPECT_EQ(std::count(taken.begin(), taken.end(), true), static_cast<std::ptrdiff_t>(cells.size()));
  EXPECT_LT(cells.size(), TableGrid::n_cells * 4 / 5);
}

TEST(TableAccumulator, TenThousandSamplesKeepTheirMean) {
  TableAccumulator accumulator(1);
  const HalfDiff c{20.1 * degree, 30.9 * degree, 60.2 * degree};
  for (int i = 0; i < 10000; ++i) accumulator.add(0, c, 0.7, 0.01, 0.3);
  const auto table = accumulator.table(false);
  const auto& t = table.channels[0];
  const std::size_t i = TableGrid::index(c);
  EXPECT_NEAR(t.mean[i], 0.7, 1e-7);
  EXPECT_NEAR(t.variance[i] / (0.01 / 10000), 1, 1e-4);  // a float sum: equal terms are all rounded the same way
  EXPECT_NEAR(t.theta_d[i] / degree, 30.9, 1e-3);  // float sums: a thousandth of the cell
  EXPECT_NEAR(t.phi_d[i] / degree, 60.2, 1e-3);
}

/// One-channel table whose reachable cells hold g(continuous theta_h, theta_d, phi_d index of the centre).
template <typename Function>
HalfAngleTable table_of(const Function& g) {
  HalfAngleTable table(1);
  auto& t = table.channels[0];
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i) {
    const TableGrid::Cell cell = TableGrid::cell(i);
    if (!TableGrid::reachable(cell)) continue;
    t.mean[i] = static_cast<float>(g(cell.theta_h + 0.5, cell.theta_d + 0.5, cell.phi_d + 0.5));
    t.origin[i] = CellOrigin::measured;
  }
  return table;
}

TEST(TableBrdf, InterpolationReproducesALinearFunctionOfTheGridCoordinates) {
  const auto g = [](double h, double d, double p) { return 3 + 0.5 * h - 0.25 * d + 0.125 * p; };
  const TableBrdf brdf(table_of(g), "linear");
  std::mt19937_64 generator(3);
  std::uniform_real_distribution<double> uniform(0, 1);
  for (int i = 0; i < 5000; ++i) {
    const double h = 1 + 40 * uniform(generator), d = 1 + 50 * uniform(generator),
                 p = 0.5 + 179 * uniform(generator);
    const HalfDiff c{h * h / 8100 * pi / 2, d * degree, p * degree};
    const glm::dvec3 f = brdf.value(directions(c)).value();
    EXPECT_NEAR(f.x, g(h, d, p), 1e-5);  // float entries of up to 40
    EXPECT_EQ(f.x, f.y);                 // one channel is grey
    EXPECT_EQ(f.x, f.z);
  }
}

TEST(TableBrdf, InterpolationWrapsAroundPhiDByReciprocity) {
  const auto g = [](double, double, double p) { return std::sin(2 * p * degree); };  // has the period pi
  const TableBrdf brdf(table_of(g), "periodic");
  for (const double p : {-0.4, -0.1, 0.0, 0.1, 0.4, 179.7}) {
    const double f = brdf.value(directions({10 * degree, 30 * degree, p * degree})).value().x;
    EXPECT_NEAR(f, std::sin(2 * p * degree), 2e-6);  // without the wrap 0.003 to 0.017 off
  }
}

TEST(TableBrdf, AConstantTableIsConstantEverywhereItIsReachable) {
  const TableBrdf brdf(table_of([](double, double, double) { return 0.75; }), "constant");
  std::mt19937_64 generator(4);
  std::uniform_real_distribution<double> uniform(0, 1);
  int n_defined = 0;
  for (int i = 0; i < 5000; ++i) {
    const Directions d{direction(std::acos(uniform(generator)), 2 * pi * uniform(generator)),
                       direction(std::acos(uniform(generator)), 2 * pi * uniform(generator))};
    const auto f = brdf.value(d);
    if (!f) continue;  // the nearest cell's centre is below the horizon
    ++n_defined;
    EXPECT_NEAR(f->x, 0.75, 1e-15);
  }
  EXPECT_GT(n_defined, 4800);
  EXPECT_NEAR(brdf.value({{0, 0, 1}, {0, 0, 1}}).value().x, 0.75, 1e-15);
}

TEST(TableBrdf, AHoleSaysNothingAndDoesNotPullItsNeighboursDown) {
  HalfAngleTable table = table_of([](double, double, double) { return 2.0; });
  const TableGrid::Cell hole{30, 30, 90};
  table.channels[0].origin[TableGrid::index(hole)] = CellOrigin::empty;
  table.channels[0].mean[TableGrid::index(hole)] = 0;
  const TableBrdf brdf(std::move(table), "hole");
  EXPECT_FALSE(brdf.value(directions(TableGrid::centre(hole))).has_value());
  const HalfDiff beside{TableGrid::centre(hole).theta_h, 31.01 * degree,
                        90.5 * degree};  // just outside the hole's cell
  EXPECT_NEAR(brdf.value(directions(beside)).value().x, 2.0, 1e-12);
}

TEST(TableBrdf, AHoleInOneChannelIsAHoleOfTheColour) {
  HalfAngleTable table(3);
  const std::size_t i = TableGrid::index(TableGrid::Cell{20, 20, 20});
  for (auto& channel : table.channels) {
    channel.origin[i] = CellOrigin::measured;
    channel.mean[i] = 1;
  }
  table.channels[2].origin[i] = CellOrigin::empty;
  EXPECT_FALSE(TableBrdf(table, "two of three").value(directions(TableGrid::centre(i))).has_value());
}

TEST(TableBrdf, WithoutInterpolationTheNearestCellAnswers) {
  const TableBrdf brdf(table_of([](double h, double, double) { return h; }), "steps", false);
  EXPECT_EQ(brdf.value(directions({TableGrid::theta_h_edge(20) * 1.0001, 0.3, 0.3})).value().x, 20.5);
  EXPECT_EQ(brdf.value(directions({TableGrid::theta_h_edge(21) * 0.9999, 0.3, 0.3})).value().x, 20.5);
}

TEST(TableBrdf, ATwoChannelTableIsRefused) {
  EXPECT_THROW(TableBrdf(HalfAngleTable(2), "two"), Error);
  EXPECT_THROW(TableBrdf(HalfAngleTable(0), "none"), Error);
}

TEST(TabulateBrdf, HoldsTheModelAtTheCentresAndNothingBelowTheHorizon) {
  const CookTorranceBrdf paint(test::table1_paint("polaris-silber"));
  const HalfAngleTable table = tabulate_brdf(paint, 0.1);
  for (std::size_t i = 0; i < TableGrid::n_cells; i += 977) {
    const auto c = half_angle_cosines(TableGrid::centre(i));
    const auto& t = table.channels[1];
    if (std::min(c.n_dot_i, c.n_dot_o) <= 0.1) {
      EXPECT_EQ(t.origin[i], CellOrigin::empty);
      EXPECT_EQ(t.mean[i], 0.0f);
      EXPECT_EQ(t.count[i], 0u);
    } else {
      EXPECT_EQ(t.origin[i], CellOrigin::measured);
      EXPECT_NEAR(t.mean[i] / paint.model().value(c).y, 1, 1e-7);  // float
      EXPECT_EQ(t.variance[i], 0.0f);
    }
  }
}

TEST(TabulateBrdf, DoesNotDependOnTheNumberOfThreads) {
  const CookTorranceBrdf paint(test::table1_paint("white"));
  const auto with_threads = [&](std::size_t n) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism, n);
    return tabulate_brdf(paint).channels[0].mean;
  };
  EXPECT_EQ(with_threads(1), with_threads(4));
}

}  // namespace
}  // namespace lacquer::brdf
