#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <random>

#include "libbrdf/brdf.h"
#include "libbrdf/files.h"
#include "libbrdf/table.h"
#include "libfit/fit.h"
#include "libfit/objective.h"
#include "libfit/observations.h"
#include "libfit/solver.h"
#include "tools/plot.h"

/// Speed against error of the fit, beside SciPy on the same cells; which structure is chosen at which noise; how often error bars cover.
namespace {

using namespace lacquer;

constexpr double noise = 0.05;
const std::vector<std::string> paint_names{"ford-f8", "polaris-silber", "opel-titan", "bmw-339", "2k-acrylack", "white", "blue", "blue-matte"};

brdf::CookTorrance paint(const std::string& name) {
  return brdf::read_model(std::filesystem::path(LACQUER_SOURCE_DIR) / "data-samples" / "paints" / (name + ".json"));
}

brdf::HalfAngleTable table_of(const brdf::CookTorrance& model) { return brdf::tabulate_brdf(brdf::CookTorranceBrdf(model), 0.0); }

/// Adds `clean`'s values and relative Gaussian noise to `table`, with its true variance.
void set_noisy(const brdf::HalfAngleTable& clean, double relative, std::uint64_t seed, brdf::HalfAngleTable& table) {
  std::mt19937_64 generator(seed);
  std::normal_distribution<double> normal;
  for (std::size_t c = 0; c < table.channels.size(); ++c)
    for (std::size_t i = 0; i < brdf::TableGrid::n_cells; ++i) {
      if (clean.channels[c].origin[i] != brdf::CellOrigin::measured) continue;
      const double mean = clean.channels[c].mean[i], sigma = relative * mean;
      table.channels[c].variance[i] = static_cast<float>(sigma * sigma);
      table.channels[c].mean[i] = static_cast<float>(mean + sigma * normal(generator));
    }
}

/// Parameters in the order of FitResult::parameters.
std::vector<double> values_of(const brdf::CookTorrance& model) {
  std::vector<double> values{model.kd.x, model.kd.y, model.kd.z};
  for (const auto& lobe : model.lobes) values.insert(values.end(), {lobe.ks.x, lobe.ks.y, lobe.ks.z});
  for (const auto& lobe : model.lobes) values.insert(values.end(), {lobe.m, lobe.r});
  return values;
}

double largest_error(const std::vector<double>& x, const std::vector<double>& truth) {
  double largest = 0;
  for (std::size_t k = 0; k < truth.size(); ++k) largest = std::max(largest, std::abs(x[k] / truth[k] - 1));
  return largest;
}

double peak_memory_mb() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024;
}

struct SciPy {
  double seconds = std::nan(""), error = std::nan("");
};

/// SciPy on the cells that a fit with `max_cells` uses, from a start 20 % off the truth; NaN: no answer in time.
SciPy scipy(const brdf::HalfAngleTable& table, std::size_t max_cells, const brdf::CookTorrance& truth, const std::filesystem::path& folder,
            int limit_s) {
  fit::Observations o = fit::observe(table, fit::stratified_choice(fit::usable_cells(table, {}), max_cells));
  const fit::CellSet& set = o.sets.front();
  std::vector<double> rows;
  for (std::size_t k = 0; k < set.size(); ++k) {
    rows.insert(rows.end(), {set.tan2_theta_h[k], set.schlick_weight[k], set.front[k]});
    for (const auto& channel : table.channels) rows.push_back(std::max(channel.mean[set.cell[k]], 1e-6f));
    rows.insert(rows.end(), {noise, 0});
  }
  std::vector<double> start = values_of(truth);
  for (std::size_t k = 0; k < start.size(); ++k) start[k] *= k % 2 ? 0.8 : 1.2;
  for (std::size_t k = 12; k < 18; k += 2) start[k] = std::log(start[k]);
  const auto cells = folder / "cells.f64", start_file = folder / "start.json", answer = folder / "answer.json";
  std::ofstream(cells, std::ios::binary).write(reinterpret_cast<const char*>(rows.data()), static_cast<std::streamsize>(rows.size() * sizeof(double)));
  std::ofstream(start_file) << nlohmann::json(start).dump();
  const std::string command = fmt::format("/usr/bin/python3 '{}/bench/fit/scipy_fit.py' '{}' '{}' {} > '{}' 2> /dev/null", LACQUER_SOURCE_DIR,
                                          cells.string(), start_file.string(), limit_s, answer.string());
  if (std::system(command.c_str()) != 0) return {};
  const auto j = nlohmann::json::parse(std::ifstream(answer));
  return {j.at("seconds"), largest_error(j.at("x").get<std::vector<double>>(), values_of(truth))};
}

void speed(const std::filesystem::path& folder, const std::string& plot, int limit_s, bool smoke) {
  std::filesystem::create_directories(folder);
  const brdf::CookTorrance truth = paint("ford-f8");
  brdf::HalfAngleTable table = table_of(truth);
  set_noisy(table, noise, 1, table);
  if (!smoke) {
    const double before = peak_memory_mb();
    fit::fit_table(table, {.model_sigma = 1e-3});
    fmt::print("all cells, structure chosen: peak memory {:.0f} MB, before the fit {:.0f} MB\n", peak_memory_mb(), before);
  }
  fmt::print("cells   ours s (three lobes)  with selection s  largest parameter error %   SciPy s  largest error %\n");
  std::vector<std::vector<double>> columns(6);
  const std::vector<std::size_t> sizes = smoke ? std::vector<std::size_t>{1000} : std::vector<std::size_t>{1000, 3000, 10000, 40000, 100000, 300000, 1000000};
  for (const std::size_t n : sizes) {
    double forced = 1e9, selected = 1e9, error = 0;
    for (int repeat = 0; repeat < 3; ++repeat) {
      const fit::FitResult fit = fit::fit_table(table, {.n_lobes = 3, .max_cells = n, .model_sigma = 1e-3});
      forced = std::min(forced, fit.seconds);
      error = largest_error(values_of(fit.model), values_of(truth));
      selected = std::min(selected, fit::fit_table(table, {.max_cells = n, .model_sigma = 1e-3}).seconds);
    }
    const SciPy peer = scipy(table, n, truth, folder, limit_s);
    fmt::print("{:7}  {:8.3f}  {:8.3f}  {:8.3f}   {:8.3f}  {:8.3f}\n", n, forced, selected, 100 * error, peer.seconds, 100 * peer.error);
    const double row[] = {static_cast<double>(n), forced, selected, 100 * error, peer.seconds, 100 * peer.error};
    for (std::size_t k = 0; k < 6; ++k) columns[k].push_back(row[k]);
  }
  std::fflush(stdout);
  if (plot.empty()) return;
  tools::gnuplot(tools::plot_data("d", columns) +
                     "set logscale xy\nset format x '10^{%L}'\nset key left top\nset xlabel 'cells'\n"
                     "set ylabel 'seconds; largest error of a parameter, %'\n"
                     "plot $d u 1:2 w lp lw 2 lc rgb blue t 'seconds, three lobes', '' u 1:3 w lp lw 2 lc rgb sky t 'seconds, structure chosen', "
                     "'' u 1:5 w lp lw 2 lc rgb vermilion t 'seconds, SciPy', '' u 1:4 w lp dt 2 lc rgb blue t 'error', "
                     "'' u 1:6 w lp dt 2 lc rgb vermilion t 'error, SciPy'\n",
                 plot);
}

void selection(std::size_t max_cells) {
  fmt::print("paint            noise %  chosen                     next best (criterion)\n");
  for (const double relative : {0.01, 0.05})
    for (const std::string& name : paint_names) {
      const brdf::HalfAngleTable clean = table_of(paint(name));
      brdf::HalfAngleTable table = clean;
      set_noisy(clean, relative, 1, table);
      const fit::FitResult fit = fit::fit_table(table, {.max_cells = max_cells});
      fmt::print("{:<16} {:6g}  {:<26} {} ({:+.4g})   {:.2f} s\n", name, 100 * relative, fit.candidates[0].structure, fit.candidates[1].structure,
                 fit.candidates[1].criterion, fit.seconds);
    }
}

void coverage(int repeats, std::size_t max_cells) {
  const brdf::CookTorrance truth = paint("ford-f8");  // no parameter at a bound
  const brdf::HalfAngleTable clean = table_of(truth);
  brdf::HalfAngleTable table = clean;
  const std::vector<double> expected = values_of(truth);
  std::vector<int> one(expected.size()), two(expected.size());
  std::vector<double> largest;
  std::string names;
  for (int seed = 1; seed <= repeats; ++seed) {
    set_noisy(clean, noise, static_cast<std::uint64_t>(seed), table);
    const fit::FitResult fit = fit::fit_table(table, {.n_lobes = 3, .n_starts = 2, .max_cells = max_cells, .model_sigma = 1e-4});
    for (std::size_t k = 0; k < expected.size(); ++k) {
      const double pull = std::abs(fit.parameters[k].value - expected[k]) / fit.parameters[k].sigma;
      one[k] += pull < 0.994458;  // 68 %
      two[k] += pull < 1.959964;  // 95 %
    }
    largest.push_back(largest_error(values_of(fit.model), expected));
  }
  const fit::FitResult last = fit::fit_table(table, {.n_lobes = 3, .n_starts = 2, .max_cells = max_cells, .model_sigma = 1e-4});
  fmt::print("parameter  inside 68 %  inside 95 %   ({} repeats)\n", repeats);
  double sum1 = 0, sum2 = 0;
  for (std::size_t k = 0; k < expected.size(); ++k) {
    fmt::print("{:<10} {:8.1f}  {:8.1f}\n", last.parameters[k].name, 100.0 * one[k] / repeats, 100.0 * two[k] / repeats);
    sum1 += one[k], sum2 += two[k];
  }
  const double n = static_cast<double>(repeats) * static_cast<double>(expected.size());
  std::sort(largest.begin(), largest.end());
  fmt::print("all        {:8.1f}  {:8.1f}\nlargest error of a parameter: median {:.2f} %, worst repeat {:.2f} %\n", 100 * sum1 / n, 100 * sum2 / n,
             100 * largest[largest.size() / 2], 100 * largest.back());
}

/// Least cost of the same objective on the same cells and weights, by SciPy from random starts; NaN: none came back.
double scipy_film(const fit::Observations& observations, int n_lobes, int starts, const std::filesystem::path& folder) {
  std::vector<double> rows;
  for (const fit::CellSet& set : observations.sets)
    for (std::size_t k = 0; k < set.size(); ++k) {
      rows.insert(rows.end(), {set.tan2_theta_h[k], set.schlick_weight[k], set.front[k]});
      double target[3] = {1, 1, 1}, weight[3] = {};
      for (int c = 0; c < set.n_channels; ++c) {
        target[set.first_channel + c] = set.channels[c].target[k];
        weight[set.first_channel + c] = set.channels[c].inverse_sigma[k];
      }
      rows.insert(rows.end(), target, target + 3);
      rows.insert(rows.end(), weight, weight + 3);
    }
  std::filesystem::create_directories(folder);
  const auto cells = folder / "film.f64", answer = folder / "film.json";
  std::ofstream(cells, std::ios::binary).write(reinterpret_cast<const char*>(rows.data()), static_cast<std::streamsize>(rows.size() * sizeof(double)));
  const std::string command = fmt::format("/usr/bin/python3 '{}/bench/fit/scipy_films.py' '{}' {} {} > '{}' 2> /dev/null", LACQUER_SOURCE_DIR,
                                          cells.string(), n_lobes, starts, answer.string());
  if (std::system(command.c_str()) != 0) return std::nan("");
  double least = std::numeric_limits<double>::infinity();
  const auto found = nlohmann::json::parse(std::ifstream(answer));
  for (const double cost : found.at("costs")) least = std::min(least, cost);
  return least;
}

/// Error of 1, 2 and 3 lobes on each measured film, what the choice of structure takes, and the minimum beside SciPy's.
void films(const std::filesystem::path& folder, int starts, bool smoke) {
  const std::filesystem::path data = std::filesystem::path(LACQUER_SOURCE_DIR) / ".." / "shared" / "data" / "measured-brdf",
                              sample = std::filesystem::path(LACQUER_SOURCE_DIR) / "data-samples" / "measured" / "vch_golden_yellow_rgb.bsdf";
  std::vector<std::filesystem::path> files{sample};
  if (!smoke && std::filesystem::is_directory(data))
    for (const auto& entry : std::filesystem::directory_iterator(data))
      if ((entry.path().extension() == ".bsdf" || entry.path().extension() == ".binary") && entry.path().filename() != sample.filename())
        files.push_back(entry.path());
  std::sort(files.begin() + 1, files.end());
  fmt::print("film                                    lobes  mean |ln|  robust cost   least of {} SciPy starts\n", starts);
  for (const auto& file : files) {
    const auto film = brdf::load_brdf(file);
    const auto* measured = dynamic_cast<const brdf::TableBrdf*>(film.get());
    const brdf::HalfAngleTable table = measured ? measured->table() : brdf::tabulate_brdf(*film, 0.087);
    for (int n = 1; n <= (smoke ? 1 : 3); ++n) {
      const fit::FitOptions options{.n_lobes = n, .max_cells = 3000, .energy_weight = 0, .limit_groups = false};
      const fit::FitResult fit = fit::fit_table(table, options);
      fit::Observations cells = fit::observe(table, fit::stratified_choice(fit::usable_cells(table, options), options.max_cells));
      fit::weigh(cells, options.model_sigma, &fit.model);
      const fit::Objective objective(cells, fit::ParameterLayout(3, n), {});
      const double ours = fit::minimise(objective, objective.layout().pack(fit.model), {}).cost;  // the weights followed the model
      fmt::print("{:<40} {:>4}   {:8.4f}   {:13.9g}   {:13.9g}\n", file.filename().string(), n, fit.mean_abs_log, ours, scipy_film(cells, n, starts, folder));
      std::fflush(stdout);
    }
    if (smoke) return;
    const fit::FitResult chosen = fit::fit_table(table, {.max_cells = 30000});
    for (const fit::Candidate& c : chosen.candidates)
      fmt::print("    {:<60} mean |ln| {:.4f}  criterion {:+.4g}\n", c.structure, c.mean_abs_log, c.criterion);
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("bench_fit");
  bool smoke = false;
  int repeats = 300, limit_s = 120;
  std::string folder = "bench-fit", plot;
  app.add_flag("--smoke", smoke, "small and quick: only that it runs");
  app.add_option("--repeats", repeats, "of the coverage")->capture_default_str();
  app.add_option("--scipy-limit-s", limit_s, "SciPy is stopped after this time")->capture_default_str();
  app.add_option("--folder", folder, "for temporary files")->capture_default_str();
  app.add_option("--plot", plot, "SVG or PNG of time and error");
  std::string only;
  app.add_option("--only", only, "one part of it")->check(CLI::IsMember({"speed", "selection", "coverage", "films"}));
  CLI11_PARSE(app, argc, argv);
  if (smoke) return speed(folder, plot, limit_s, true), coverage(2, 1000), films(folder, 1, true), 0;
  if (only.empty() || only == "speed") speed(folder, plot, limit_s, false);
  if (only.empty() || only == "selection") selection(brdf::TableGrid::n_cells);
  if (only.empty() || only == "coverage") coverage(repeats, 40000);
  if (only == "films") films(folder, 6, false);
}
