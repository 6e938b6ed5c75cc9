#include "libfit/fit.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "bench/stability/hard_case.h"
#include "bench/stability/tables.h"
#include "libbrdf/error.h"

/// Tables that a rig or a user may well bring and that break careless fits.
namespace lacquer::bench {

namespace {

using namespace brdf;
using lacquer::fit::FitOptions;
using lacquer::fit::FitResult;
using lacquer::fit::fit_table;
using lacquer::fit::Parameter;

/// By name; a grey lobe has one "ks1" for "ks1.g".
const Parameter& parameter(const FitResult& fit, const std::string& name) {
  const auto found = std::find_if(fit.parameters.begin(), fit.parameters.end(), [&](const Parameter& p) { return p.name == name || p.name + ".g" == name; });
  if (found == fit.parameters.end()) throw std::runtime_error("the fit has no parameter " + name);
  return *found;
}

bool sane(const FitResult& fit) {
  for (const Parameter& p : fit.parameters)
    if (!std::isfinite(p.value) || !std::isfinite(p.sigma) || p.value < 0) return false;
  return fit.converged && std::isfinite(fit.mean_abs_log);
}

FitOptions exact(int n_lobes) {
  FitOptions o;
  o.n_lobes = n_lobes, o.model_sigma = 1e-4;
  return o;
}

std::string words(const Parameter& p) { return p.name + (!p.determined ? " not determined" : p.at_bound ? " at its bound" : fmt::format(" = {:.4g} ± {:.2g}", p.value, p.sigma)); }

HardCases extremes_of_the_model() {
  HardCases cases;
  double worst = 0;
  for (const double m : {0.001, 0.003, 0.01, 0.05, 0.3, 1.0}) {
    const FitResult fit = fit_table(table_of(one_lobe(0.025, m, 0.5), m < 0.01 ? 7 : 41), exact(1));
    worst = std::max(worst, sane(fit) ? std::abs(fit.model.lobes[0].m / m - 1) : NAN);
  }
  cases.push_back(at_most("one lobe, m = 0.001 to 1, noise-free", "found from a scan, no start is given", worst, 1e-5, " relative, worst m"));
  for (const double r : {0.0, 1.0}) {
    const FitResult fit = fit_table(table_of(one_lobe(0.025, 0.2, r), 41), exact(1));
    const Parameter& p = parameter(fit, "r1");
    cases.push_back({fmt::format("r = {:g}, at its bound", r), "reported as at its bound; m has its error", words(p) + ", " + words(parameter(fit, "m1")), sane(fit) && p.at_bound && std::abs(p.value - r) < 1e-4});
  }
  const FitResult under = fit_table(table_of(one_lobe(0.025, 0.03, 0.4, glm::dvec3(0.0)), 7, 0, [](const auto& c) { return c.theta_h < 45; }), exact(1));
  cases.push_back(at_most("no diffuse part: the model underflows in most cells", "log domain", sane(under) ? std::abs(under.model.lobes[0].m / 0.03 - 1) : NAN, 1e-3, " relative, m"));
  CookTorrance twins = one_lobe(0.02, 0.1, 0.5);
  twins.lobes.push_back({glm::dvec3(0.02), 0.1, 0.5});
  const FitResult twin = fit_table(table_of(twins, 41, 0.01));
  cases.push_back({"two equal lobes in the truth", "one lobe of twice the strength is chosen", fmt::format("{} lobes, ks {:.4f} (truth 0.04)", twin.model.lobes.size(), twin.model.lobes.empty() ? 0 : twin.model.lobes[0].ks.y), sane(twin) && twin.model.lobes.size() == 1 && std::abs(twin.model.lobes[0].ks.y - 0.04) < 4 * parameter(twin, "ks1.g").sigma + 1e-3});
  CookTorrance lambert;
  lambert.kd = glm::dvec3(0.5);
  const FitResult flat = fit_table(table_of(lambert, 41));
  cases.push_back({"a constant table", "no lobe is invented", fmt::format("{} lobes, kd {:.6f}", flat.model.lobes.size(), flat.model.kd.x), sane(flat) && flat.model.lobes.empty()});
  for (const double scale : {1e-6, 1e3}) {
    CookTorrance scaled = one_lobe(0.025 * scale, 0.1, 0.5, scale * glm::dvec3(0.02, 0.03, 0.04));
    HalfAngleTable table = table_of(scaled, 41);
    table.absolute_scale = false;
    const FitResult fit = fit_table(table, exact(1));
    cases.push_back(at_most(fmt::format("relative values, scaled by {:g}", scale), "residuals are logarithms", sane(fit) ? std::abs(fit.model.lobes[0].m / 0.1 - 1) : NAN, 1e-5, " relative, m"));
  }
  return cases;
}

HardCases little_or_strange_data() {
  HardCases cases;
  const FitResult row = fit_table(table_of(one_lobe(0.025, 0.2, 0.5), 1, 0, [](const auto& c) { return c.theta_d == 20; }), {.n_lobes = 1, .model_sigma = 1e-3});
  cases.push_back({"a single row of θd", "ks and r cannot be told apart: both are said to be not determined, m is", words(parameter(row, "r1")) + ", " + words(parameter(row, "ks1.g")) + ", " + words(parameter(row, "m1")), sane(row) && !parameter(row, "r1").determined && !parameter(row, "ks1.g").determined && std::abs(row.model.lobes[0].m - 0.2) < 1e-3});
  const FitResult grazing = fit_table(table_of(one_lobe(0.025, 0.2, 0.1), 3, 0, [](const auto& c) {
    const auto cosines = half_angle_cosines(TableGrid::centre(c));
    return std::max(cosines.n_dot_i, cosines.n_dot_o) < 0.35;
  }), exact(1));
  cases.push_back(at_most("directions beyond 70° only", "found", sane(grazing) ? std::abs(grazing.model.lobes[0].m / 0.2 - 1) : NAN, 5e-3, " relative, m"));
  HalfAngleTable clipped = table_of(one_lobe(0.2, 0.1, 0.5), 7, 0.05);
  for (auto& channel : clipped.channels)
    for (std::size_t i = 0; i < channel.mean.size(); ++i)
      if (channel.mean[i] > 0.1f) channel.mean[i] = 0.1f, channel.origin[i] = CellOrigin::clipped;
  const FitResult bounded = fit_table(clipped, {.n_lobes = 1});
  const Parameter& ks = parameter(bounded, "ks1.g");
  cases.push_back(at_most("a peak of 3.2 /sr of which all above 0.1 is clipped", fmt::format("bounds from below; {} (truth 0.2)", words(ks)), sane(bounded) ? std::abs(ks.value - 0.2) / ks.sigma : NAN, 4, " σ"));
  HalfAngleTable outliers = table_of(one_lobe(0.025, 0.1, 0.5), 41, 0.02);
  for (auto& channel : outliers.channels)
    for (std::size_t i = 0, k = 0; i < channel.mean.size(); ++i)
      if (channel.origin[i] == CellOrigin::measured && ++k % 100 == 0) channel.mean[i] *= 1000;
  const FitResult robust = fit_table(outliers, {.n_lobes = 1});
  cases.push_back(at_most("one cell in a hundred 1000 times too bright", "Huber's loss holds them", sane(robust) ? std::abs(robust.model.lobes[0].m / 0.1 - 1) : NAN, 0.02, " relative, m"));
  HalfAngleTable weights = table_of(one_lobe(0.025, 0.2, 0.5), 41);
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal;
  for (auto& channel : weights.channels)
    for (std::size_t i = 0; i < channel.mean.size(); ++i) {
      const double sigma = channel.mean[i] * std::pow(10.0, -4 + 6 * static_cast<double>(random() % 1000) / 999);
      channel.variance[i] = static_cast<float>(sigma * sigma);
      channel.mean[i] = static_cast<float>(channel.mean[i] + sigma * normal(random));
    }
  const FitResult decades = fit_table(weights, {.n_lobes = 1, .model_sigma = 1e-5});
  cases.push_back(at_most("relative errors of 1e-4 to 100: weights over twelve decades", "noise is compared with the model's value, not with the noisy one", sane(decades) ? std::abs(decades.model.lobes[0].m - 0.2) / parameter(decades, "m1").sigma : NAN, 4, " σ of m"));
  const FitResult mirror = fit_table(table_of(one_lobe(1e-3, 0.0015, 0.9, glm::dvec3(0.01)), 7, 0.02));
  cases.push_back(at_most("a mirror of m = 0.0015 seen by a handful of cells", fmt::format("{} lobe", mirror.model.lobes.size()), sane(mirror) && mirror.model.lobes.size() == 1 ? std::abs(mirror.model.lobes[0].m / 0.0015 - 1) : NAN, 0.05, " relative, m"));
  return cases;
}

HardCases refusals() {
  HardCases cases;
  const auto refused = [&](const std::string& what, const HalfAngleTable& table) {
    std::string text;
    try {
      fit_table(table);
    } catch (const Error& e) {
      text = e.what();
    }
    cases.push_back({what, "refused in one line", "“" + (text.empty() ? "accepted" : text.substr(0, 80)) + "”", !text.empty()});
  };
  refused("an empty table", HalfAngleTable(3));
  HalfAngleTable nan = table_of(one_lobe(0.025, 0.2, 0.5), 41);
  for (auto& channel : nan.channels) std::fill(channel.mean.begin(), channel.mean.end(), std::numeric_limits<float>::quiet_NaN());
  refused("nothing but NaN", nan);
  const HalfAngleTable table = table_of(paint("polaris-silber"), 41, 0.02);
  FitOptions one, all;
  one.threads = 1;
  const bool same = lacquer::fit::fit_to_json(fit_table(table, one), true, "{}") == lacquer::fit::fit_to_json(fit_table(table, all), true, "{}");
  cases.push_back({"one thread or all", "the same bytes of fit.json", same ? "the same" : "they differ", same});
  return cases;
}

}  // namespace

HardCases fit_cases() {
  HardCases all;
  for (const auto& part : {extremes_of_the_model(), little_or_strange_data(), refusals()}) all.insert(all.end(), part.begin(), part.end());
  return all;
}

}  // namespace lacquer::bench
