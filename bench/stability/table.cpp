#include <algorithm>
#include <cmath>
#include <numbers>
#include <random>

#include "bench/stability/hard_case.h"
#include "bench/stability/tables.h"
#include "libbrdf/error.h"
#include "libbrdf/fill_table.h"
#include "libbrdf/folded_channel.h"
#include "libbrdf/table_accumulator.h"

/// Sums over very many, very unequal or very few samples; holes with little around them.
namespace lacquer::bench {

namespace {

using namespace brdf;

/// Ten million noisy samples of one cell.
HardCases many_samples() {
  constexpr double truth = 0.1, sigma = 0.02;
  constexpr int n = 10'000'000;
  const HalfDiff centre = TableGrid::centre(TableGrid::Cell{30, 20, 50});
  std::mt19937_64 random(1);
  TableAccumulator accumulator(1);
  double mean = 0, weights = 0, square = 0;
  for (int i = 0; i < n; ++i) {
    const double u = static_cast<double>(random() >> 11) * 0x1p-53, weight = std::pow(10.0, -6 * u);  // six decades of irradiance
    const double value = truth + sigma * std::sqrt(12.0) * (static_cast<double>(random() >> 11) * 0x1p-53 - 0.5);
    accumulator.add(0, centre, value, sigma * sigma, weight);
    weights += weight, mean += weight * (value - mean) / weights, square += weight * weight;
  }
  const HalfAngleTable table = accumulator.table(false);
  const std::size_t cell = TableGrid::index(centre);
  HardCases cases;
  cases.push_back(at_most("ten million samples in one cell, weights over six decades", "mean: summed in double", std::abs(static_cast<double>(table.channels[0].mean[cell]) / mean - 1), 6e-8, " relative"));
  cases.push_back(at_most("the same", "variance: summed in float, which ten million terms wear down; 10 000 samples: 1e-4", std::abs(static_cast<double>(table.channels[0].variance[cell]) / (sigma * sigma * square / (weights * weights)) - 1), 1e-2, " relative"));
  return cases;
}

HardCases borders() {
  HardCases cases;
  std::size_t outside = 0, n = 0;
  for (const double theta : {0.0, 1e-300, 1e-12, std::numbers::pi / 2, std::nextafter(std::numbers::pi / 2, 0)})
    for (const double phi : {-std::numbers::pi, -1e-300, 0.0, std::nextafter(std::numbers::pi, 0), std::numbers::pi, 3 * std::numbers::pi}) {
      outside += TableGrid::index(HalfDiff{theta, std::numbers::pi / 2 - theta, phi}) >= TableGrid::n_cells;
      outside += fold_phi_d(phi) < 0 || fold_phi_d(phi) >= std::numbers::pi;
      n += 2;
    }
  cases.push_back({"coordinates at the ends of their ranges, φd at ±180°", "within the grid; φd folded into [0, 180°)", fmt::format("{} of {} outside", outside, n), outside == 0});
  TableAccumulator accumulator(1);
  const HalfDiff c = TableGrid::centre(TableGrid::Cell{30, 20, 50});
  accumulator.add(0, c, -0.01, 1e-4, 1);
  accumulator.add(0, c, 0.004, 1e-4, 1);
  const HalfDiff d = TableGrid::centre(TableGrid::Cell{30, 20, 60});
  accumulator.add_bound(0, d, 5, 0.01, 1);
  accumulator.add_bound(0, d, 7, 0.01, 1);
  const HalfDiff e = TableGrid::centre(TableGrid::Cell{30, 20, 70});
  accumulator.add_bound(0, e, 5, 0.01, 1);
  accumulator.add(0, e, 2, 0.01, 1);
  std::string refusal;
  try {
    accumulator.add(0, {1.5, 1.5, 0}, 1, 1, 1);
  } catch (const Error& error) {
    refusal = error.what();
  }
  const HalfAngleTable table = accumulator.table(false);
  const auto& t = table.channels[0];
  cases.push_back({"noise below zero in a dark cell", "kept: leaving it out would bias the mean", fmt::format("{:g}", t.mean[TableGrid::index(c)]), std::abs(t.mean[TableGrid::index(c)] + 0.003f) < 1e-8f});
  cases.push_back({"a cell of clipped samples alone", "origin clipped, mean of the lower bounds", fmt::format("≥ {:g}", t.mean[TableGrid::index(d)]), t.origin[TableGrid::index(d)] == CellOrigin::clipped && t.mean[TableGrid::index(d)] == 6});
  cases.push_back({"a clipped sample before one that is not", "the clipped one gives way", fmt::format("{:g}", t.mean[TableGrid::index(e)]), t.origin[TableGrid::index(e)] == CellOrigin::measured && t.mean[TableGrid::index(e)] == 2});
  cases.push_back({"half-angle coordinates whose light is below the horizon", "refused", refusal.empty() ? "accepted" : "“" + refusal.substr(0, 70) + "”", !refusal.empty()});
  return cases;
}

HardCases lookup() {
  HardCases cases;
  HalfAngleTable constant(1);
  for (std::size_t i = 0; i < TableGrid::n_cells; ++i)
    if (TableGrid::reachable(TableGrid::cell(i))) set(constant.channels[0], i, 0.25);
  const std::size_t hole = TableGrid::index(TableGrid::Cell{20, 20, 40});
  constant.channels[0].origin[hole] = CellOrigin::empty;
  constant.channels[0].mean[hole] = 0;
  const TableBrdf table(std::move(constant), "constant");
  double worst = 0;
  std::size_t n = 0, nothing = 0;
  for (double i = 0.01; i < 1.57; i += 0.037)
    for (double o = 0.01; o < 1.57; o += 0.041)
      for (double phi = 0; phi < 3.2; phi += 0.13, ++n)
        if (const auto f = table.value({direction(i, 0), direction(o, phi)})) worst = std::max(worst, std::abs(f->x - 0.25)); else ++nothing;
  cases.push_back(at_most("interpolation of a constant table to the horizon, with a hole", fmt::format("cells without a value are left out of the weights ({} of {} directions say nothing)", nothing, n), worst, 1e-15));
  const bool empty = !table.value(directions(TableGrid::centre(hole)));
  cases.push_back({"looking into the hole", "nothing, rather than the neighbours' pull towards 0", empty ? "nothing" : "a value", empty});
  return cases;
}

struct FilledCells {
  double mean = 0;        ///< |ln(filled / truth)|
  double held = 0;        ///< share within 1.96 of the stated sigma
  std::size_t n = 0;
  double deepest_sigma = 0;  ///< of the logarithm, largest
};

/// theta_h below 30 and theta_d below 30, without the cells for which `removed(h, d, folded phi_d)`.
template <typename Removed>
FilledCells fill(const CookTorrance& model, const Removed& removed) {
  HalfAngleTable table(1);
  TableChannel& t = table.channels[0];
  const auto each = [&](const auto& visit) {
    for (int h = 0; h < 30; ++h)
      for (int d = 0; d < 30; ++d)
        for (int p = 0; p < TableGrid::n_phi_d; ++p) visit(TableGrid::index(TableGrid::Cell{h, d, p}), removed(h, d, FoldedChannel::fold(p)));
  };
  const auto truth = [&](std::size_t i) { return model.value(half_angle_cosines(TableGrid::centre(i))).y; };
  each([&](std::size_t i, bool gone) {
    if (!gone) set(t, i, truth(i));
  });
  fill_holes(table, {.n_trials = 2000});
  FilledCells found;
  each([&](std::size_t i, bool gone) {
    if (!gone || t.origin[i] != CellOrigin::filled) return;
    const double error = std::abs(std::log(t.mean[i] / truth(i))), sigma = std::sqrt(t.variance[i]) / t.mean[i];
    found.mean += error;
    found.held += error <= 1.96 * sigma;
    found.deepest_sigma = std::max(found.deepest_sigma, sigma);
    ++found.n;
  });
  found.mean /= static_cast<double>(found.n), found.held /= static_cast<double>(found.n);
  return found;
}

}  // namespace

HardCases table_cases() {
  HardCases all;
  for (const auto& part : {many_samples(), borders(), lookup()}) all.insert(all.end(), part.begin(), part.end());
  return all;
}

HardCases filling_cases() {
  HardCases cases;
  const auto scattered = [](int h, int d, int p) { return std::mt19937(static_cast<unsigned>((h * 90 + d) * 90 + p))() % 10 < 3; };
  const auto add = [&](const std::string& what, const std::string& happens, const FilledCells& f, double limit) {
    cases.push_back(at_most(what, fmt::format("{}; 95 % bounds hold in {:.0f} %", happens, 100 * f.held), f.mean, limit, " mean abs ln"));
  };
  add("exact data (variance 0), 30 % of the cells missing", "the kriging matrix stays positive definite", fill(paint("blue-matte"), scattered), 1e-3);
  add("a clear coat of m = 0.013: neighbours differ by factors", "logarithms, the row's mean taken off first", fill(paint("polaris-silber"), scattered), 1e-3);
  add("20° of φd missing", "kriged across the gap", fill(paint("polaris-silber"), [](int, int, int p) { return p >= 40 && p < 60; }), 0.01);
  add("every second θd row missing", "kriged", fill(paint("polaris-silber"), [](int, int d, int) { return d % 2 == 1; }), 0.005);
  const FilledCells few = fill(paint("blue"), [](int h, int d, int p) { return (h * 7 + d * 3 + p) % 50 != 0; });
  add("one cell in fifty known", fmt::format("filled where known to a factor e^0.5, largest σ {:.2f}", few.deepest_sigma), few, 0.1);
  HalfAngleTable empty(1);
  const FillReport none = fill_holes(empty).at(0);
  cases.push_back({"an empty table", "stays empty", fmt::format("{} cells filled", none.n_filled), none.n_filled == 0});
  HalfAngleTable single(1);
  set(single.channels[0], TableGrid::index(TableGrid::Cell{30, 20, 50}), 0.1);
  const FillReport one = fill_holes(single).at(0);
  cases.push_back({"a single measured cell", "its mirror cell is the same; nothing else is made up", fmt::format("{} cells filled", one.n_filled), one.n_filled <= 1});
  return cases;
}

}  // namespace lacquer::bench
