#include "tools/summary.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "libbrdf/error.h"
#include "tools/fit_table.h"

namespace lacquer::tools {

namespace {

/// `truth` with its lobes in the order of the fitted ones they resemble most: least sum of |ln(m ratio)|, weighted by the true lobe's ks,
/// so that a lobe that hardly exists does not take another's place.
brdf::CookTorrance matched(brdf::CookTorrance truth, const brdf::CookTorrance& fitted) {
  const auto strength = [](const auto& lobe) { return lobe.ks.x + lobe.ks.y + lobe.ks.z; };
  while (truth.lobes.size() > fitted.lobes.size())  // the weakest have nothing to stand beside
    truth.lobes.erase(std::min_element(truth.lobes.begin(), truth.lobes.end(), [&](const auto& a, const auto& b) { return strength(a) < strength(b); }));
  std::vector<std::size_t> order(truth.lobes.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  if (order.size() != fitted.lobes.size()) return truth;
  std::vector<std::size_t> best = order;
  double least = std::numeric_limits<double>::infinity();
  do {
    double sum = 0;
    for (std::size_t i = 0; i < order.size(); ++i) {
      const auto& lobe = truth.lobes[order[i]];
      sum += (lobe.ks.x + lobe.ks.y + lobe.ks.z) * std::abs(std::log(lobe.m / fitted.lobes[i].m));
    }
    if (sum < least) least = sum, best = order;
  } while (std::next_permutation(order.begin(), order.end()));
  brdf::CookTorrance result = truth;
  for (std::size_t i = 0; i < best.size(); ++i) result.lobes[i] = truth.lobes[best[i]];
  return result;
}

/// Parameters of a model with the names of FitResult::parameters.
std::vector<std::pair<std::string, double>> named_parameters(const brdf::CookTorrance& model) {
  std::vector<std::pair<std::string, double>> named;
  for (int c = 0; c < 3; ++c) named.emplace_back(fmt::format("kd.{}", "rgb"[c]), model.kd[c]);
  for (std::size_t i = 0; i < model.lobes.size(); ++i) {
    for (int c = 0; c < 3; ++c) named.emplace_back(fmt::format("ks{}.{}", i + 1, "rgb"[c]), model.lobes[i].ks[c]);
    named.emplace_back(fmt::format("m{}", i + 1), model.lobes[i].m);
    named.emplace_back(fmt::format("r{}", i + 1), model.lobes[i].r);
  }
  return named;
}

}  // namespace

double cosine_of_degrees(const std::string& option, double degrees) {
  if (!(degrees > 0 && degrees < 90)) throw Error(ErrorCode::usage, fmt::format("{}: expected an angle in (0, 90) degrees, got {}", option, degrees));
  return std::cos(degrees * 3.14159265358979323846 / 180);
}

std::string coverage_text(const calib::Tabulation& tabulation) {
  const auto& counts = tabulation.counts;
  std::size_t reachable = 0, measured = 0, symmetric = 0;
  const auto& channel = tabulation.table.channels[tabulation.table.channels.size() / 2];
  for (std::size_t i = 0; i < brdf::TableGrid::n_cells; ++i) {
    reachable += brdf::TableGrid::reachable(brdf::TableGrid::cell(i));
    measured += channel.origin[i] == brdf::CellOrigin::measured;
    symmetric += channel.origin[i] == brdf::CellOrigin::symmetric;
  }
  const auto percent = [&](std::size_t n) { return 100.0 * static_cast<double>(n) / static_cast<double>(reachable); };
  return fmt::format(
      "samples: {} used\n"
      "left out: {} near the horizon or in the light's shadow, {} at the peak seen too obliquely,\n"
      "          {} clipped in every exposure, {} invalid\n"
      "cells: {:.1f} % of the {} reachable ones measured, {:.1f} % more by mirror symmetry{}",
      counts.used, counts.grazing, counts.blurred, counts.clipped, counts.invalid, percent(measured), reachable, percent(symmetric),
      tabulation.table.channels.size() == 3 ? " (green channel)" : "");
}

namespace {

/// What a reader must know of a parameter besides its error.
std::string note_on(const fit::Parameter& p) {
  std::string note = !p.determined ? "not determined by the data" : p.at_bound ? "at its bound" : "";
  if (p.profile)
    note += fmt::format("{}profile 68 % [{:.5g}, {:.5g}], 95 % [{:.5g}, {:.5g}]", note.empty() ? "" : "; ", p.profile->low68, p.profile->high68,
                        p.profile->low95, p.profile->high95);
  return note;
}

}  // namespace

std::vector<ParameterRow> parameter_rows(const fit::FitResult& fit, const brdf::CookTorrance* truth) {
  const auto true_values = truth ? named_parameters(matched(*truth, fit.model)) : std::vector<std::pair<std::string, double>>{};
  std::vector<ParameterRow> rows;
  for (const auto& p : fit.parameters) {
    const auto found = std::find_if(true_values.begin(), true_values.end(), [&](const auto& t) { return t.first == p.name; });
    rows.push_back({p.name, p.determined ? with_error(p.value, p.sigma) : fmt::format("{:.2g}", p.value), found != true_values.end() ? fmt::format("{:.5g}", found->second) : "",
                    note_on(p)});
  }
  return rows;
}

std::string parameter_table(const fit::FitResult& fit, const brdf::CookTorrance* truth) {
  std::string text = fmt::format("{:<12}", "parameter") + (truth ? fmt::format("{:<26}truth", "fitted") : "fitted") + "\n";
  for (const auto& row : parameter_rows(fit, truth)) {
    std::string line = fmt::format("{:<12}{:<26}", row.name, row.fitted);  // columns, not bytes
    if (!row.truth.empty()) line += fmt::format("{:<10}", row.truth);
    if (!row.note.empty()) line += "  " + row.note;
    text += line.substr(0, line.find_last_not_of(' ') + 1) + "\n";
  }
  return text;
}

std::string difference_text(const brdf::BrdfDifference& d) {
  std::string text;
  text += fmt::format("mean |ln ratio|        {:.5f}\n", d.mean_abs_log);
  text += fmt::format("rms ln ratio           {:.5f}\n", d.rms_log);
  text += fmt::format("mean ln ratio          {:+.5f}\n", d.bias_log);
  text += fmt::format("largest |ln ratio|     {:.4f}\n", d.max_abs_log);
  text += fmt::format("cosine-weighted RMS    {:.4f} %\n", 100 * d.cosine_rms);
  text += fmt::format("cube-root RMS          {:.5f} sr^(-1/3)\n", d.cube_root_rms);
  text += fmt::format("dE2000 of lit sphere   {:.3f} mean, {:.3f} 95th percentile\n", d.delta_e_mean, d.delta_e_p95);
  text += fmt::format("directions compared    {}", d.n_directions);
  if (d.n_undefined) text += fmt::format(" ({} where one of the two says nothing)", d.n_undefined);
  if (d.scale != 1) text += fmt::format("\nscale applied to B     {:.6g}", d.scale);
  return text + "\n";
}

}  // namespace lacquer::tools
