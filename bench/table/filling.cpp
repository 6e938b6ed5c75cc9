#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <functional>
#include <random>
#include <string>

#include "bench/table/parts.h"
#include "libbrdf/brdf.h"
#include "libbrdf/files.h"
#include "libbrdf/fill_table.h"
#include "libbrdf/folded_channel.h"

/// Cells are taken out of full tables and filled again: error of ours, of the nearest neighbour, of a weighted sum of the neighbours.
namespace lacquer::bench {

namespace {

using brdf::CellOrigin;
using Grid = brdf::TableGrid;
using Folded = brdf::FoldedChannel;

/// Both halves of a mirror pair go together: a pair of which one half is known is no hole.
struct Case {
  const char* name;
  std::function<bool(const Folded::Place&)> removed;
};

std::vector<Case> cases() {
  return {{"30 % at random", [](const Folded::Place& c) {
             std::mt19937_64 generator(Folded::index(c) * 2654435761u + 12345);
             generator.discard(2);
             return generator() % 10 < 3;
           }},
          {"every 2nd theta_d", [](const Folded::Place& c) { return c.d % 2 == 1; }},
          {"20 deg of phi_d", [](const Folded::Place& c) { return c.p >= 80; }}};
}

/// Green channel; measured films averaged over both directions, as reciprocity demands (they are off by 5 to 16 %).
brdf::HalfAngleTable green(const brdf::Brdf& source, bool average) {
  brdf::HalfAngleTable table(1);
  brdf::TableChannel& t = table.channels[0];
  for (std::size_t i = 0; i < Grid::n_cells; ++i) {
    const brdf::Directions d = brdf::directions(Grid::centre(i));
    if (std::min(d.wi.z, d.wo.z) <= 0) continue;
    const auto f = source.value(d), g = average ? source.value({d.wo, d.wi}) : f;
    const double value = f && g ? (f->y + g->y) / 2 : 0;
    if (!(value > 0)) continue;
    t.mean[i] = static_cast<float>(value);
    t.count[i] = 1;
    t.origin[i] = CellOrigin::measured;
  }
  return table;
}

std::vector<std::size_t> remove(const Case& what, brdf::TableChannel& t) {
  std::vector<std::size_t> removed;
  for (std::size_t i = 0; i < Grid::n_cells; ++i) {
    const Grid::Cell c = Grid::cell(i);
    if (t.origin[i] != CellOrigin::measured || !Grid::reachable(c, 0.0349) || !what.removed({c.theta_h, c.theta_d, Folded::fold(c.phi_d)})) continue;
    removed.push_back(i);
    t.origin[i] = CellOrigin::empty;
    t.mean[i] = 0;
    t.count[i] = 0;
  }
  return removed;
}

/// Weighted sum of the neighbour samples, as the paper fills its holes (Günther et al. 2005, 4.1, which does not give the weights): inverse squared
/// distance over the smallest cube of cells around the hole that has at least four.
double weighted_sum(const brdf::TableChannel& t, std::size_t hole) {
  const Grid::Cell c = Grid::cell(hole);
  for (int reach = 1; reach <= 12; ++reach) {
    double sum = 0, weights = 0;
    int n = 0;
    for (int h = std::max(0, c.theta_h - reach); h <= std::min(Grid::n_theta_h - 1, c.theta_h + reach); ++h)
      for (int d = std::max(0, c.theta_d - reach); d <= std::min(Grid::n_theta_d - 1, c.theta_d + reach); ++d)
        for (int p = c.phi_d - reach; p <= c.phi_d + reach; ++p) {
          const std::size_t i = Grid::index(Grid::Cell{h, d, (p + Grid::n_phi_d) % Grid::n_phi_d});
          if (t.origin[i] != CellOrigin::measured) continue;
          const double w = 1.0 / ((h - c.theta_h) * (h - c.theta_h) + (d - c.theta_d) * (d - c.theta_d) + (p - c.phi_d) * (p - c.phi_d));
          sum += w * t.mean[i];
          weights += w;
          ++n;
        }
    if (n >= 4) return sum / weights;
  }
  return 0;
}

/// Value of the nearest measured cell, distances in cells.
double nearest(const brdf::TableChannel& t, std::size_t hole) {
  const Grid::Cell c = Grid::cell(hole);
  int best = 1 << 30;
  double value = 0;
  for (int reach = 1; reach <= 12 && best > reach * reach - 1; ++reach)
    for (int h = std::max(0, c.theta_h - reach); h <= std::min(Grid::n_theta_h - 1, c.theta_h + reach); ++h)
      for (int d = std::max(0, c.theta_d - reach); d <= std::min(Grid::n_theta_d - 1, c.theta_d + reach); ++d) {
        const bool face = std::abs(h - c.theta_h) == reach || std::abs(d - c.theta_d) == reach;
        for (int p = c.phi_d - reach; p <= c.phi_d + reach; p += face ? 1 : 2 * reach) {
          const std::size_t i = Grid::index(Grid::Cell{h, d, (p + Grid::n_phi_d) % Grid::n_phi_d});
          const int distance = (h - c.theta_h) * (h - c.theta_h) + (d - c.theta_d) * (d - c.theta_d) + (p - c.phi_d) * (p - c.phi_d);
          if (t.origin[i] != CellOrigin::measured || distance >= best) continue;
          best = distance;
          value = t.mean[i];
        }
      }
  return value;
}

struct Errors {
  double sum = 0, sum_all = 0;
  std::size_t n = 0, n_all = 0;
  void add(double value, double truth, bool within) {
    if (!(value > 0)) return;
    const double e = std::abs(std::log(value / truth));
    sum_all += e;
    ++n_all;
    if (within) sum += e, ++n;
  }
  double mean() const { return n ? sum / static_cast<double>(n) : NAN; }
  double mean_all() const { return n_all ? sum_all / static_cast<double>(n_all) : NAN; }
};

void fill_again(const std::string& name, const brdf::HalfAngleTable& full, const Case& what, bool smoke) {
  static const double cos_75 = std::cos(75 * std::acos(-1.0) / 180);
  brdf::HalfAngleTable table = full;
  const std::vector<std::size_t> removed = remove(what, table.channels[0]);
  const brdf::TableChannel holes = table.channels[0];
  const auto begin = std::chrono::steady_clock::now();
  const brdf::FillReport report = brdf::fill_holes(table, {.n_trials = smoke ? 500u : 6000u})[0];
  const double time = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();

  Errors ours, sum, near;
  std::size_t covered = 0, covered_all = 0;
  for (std::size_t k = 0; k < removed.size(); ++k) {
    const std::size_t i = removed[k];
    const double truth = full.channels[0].mean[i];
    const bool within = Grid::reachable(Grid::cell(i), cos_75);
    const brdf::TableChannel& t = table.channels[0];
    if (t.origin[i] == CellOrigin::filled) {
      ours.add(t.mean[i], truth, within);
      const bool holds = std::abs(std::log(t.mean[i] / truth)) <= 1.96 * std::sqrt(t.variance[i]) / t.mean[i];
      covered_all += holds;
      covered += holds && within;
    }
    if (k % (smoke ? 100 : 10) == 0) {  // the peers are slow
      sum.add(weighted_sum(holes, i), truth, within);
      near.add(nearest(holes, i), truth, within);
    }
  }
  const auto percent = [](std::size_t a, std::size_t b) { return b ? 100.0 * static_cast<double>(a) / static_cast<double>(b) : 0.0; };
  fmt::print("| {} | {} | {:.4f} | {:.4f} | {:.4f} | {:.4f} | {:.4f} | {:.4f} | {:.1f} | {:.1f} | {:.2f} | {:.1f} | {:g} |\n", name, what.name, ours.mean(),
             sum.mean(), near.mean(), ours.mean_all(), sum.mean_all(), near.mean_all(), percent(covered, ours.n), percent(covered_all, ours.n_all),
             percent(removed.size() - ours.n_all, removed.size()), time, report.length_scale);
  std::fflush(stdout);
}

}  // namespace

void filling(const std::filesystem::path& source, const std::filesystem::path& shared, bool smoke) {
  fmt::print("mean |ln(filled / true)| of the cells taken out, green channel\n\n"
             "| | taken out | ours, within 75 deg | weighted sum | nearest | ours, all | weighted sum | nearest | 95 % bounds hold, within 75 deg, % | all, % | left empty, % | s | length scale |\n"
             "|---|---|---|---|---|---|---|---|---|---|---|---|---|\n");
  const auto each = [&](const std::string& name, const brdf::HalfAngleTable& full) {
    for (const Case& what : cases())
      if (!smoke || what.name == std::string("20 deg of phi_d")) fill_again(name, full, what, smoke);
  };
  for (const char* paint : {"ford-f8", "polaris-silber", "opel-titan", "bmw-339", "2k-acrylack", "white", "blue", "blue-matte"}) {
    each(paint, green(brdf::CookTorranceBrdf(brdf::read_model(source / "data-samples" / "paints" / (std::string(paint) + ".json"))), false));
    if (smoke) return;
  }
  const std::filesystem::path films = shared / "measured-brdf";
  if (!std::filesystem::is_directory(films)) {
    fmt::print("\nno measured films: {} does not exist\n", films.string());
    return;
  }
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(films))
    if (entry.path().extension() == ".bsdf") files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  for (const auto& file : files) each(file.stem().string(), green(*brdf::load_brdf(file), true));
}

}  // namespace lacquer::bench
