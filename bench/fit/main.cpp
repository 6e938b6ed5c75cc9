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
#include <numeric>
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
  return static_cast<double>(usage.ru_maxrss) * 1024 / 1e6;
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
    const fit::FitResult fit = fit::fit_and_free_places(table, {.model_sigma = 1e-3});
    const double lean = peak_memory_mb();
    table = brdf::HalfAngleTable(0);
    table = table_of(truth);
    set_noisy(table, noise, 1, table);
    fit::fit_table(table, {.model_sigma = 1e-3});
    fmt::print("all {} cells, structure chosen: peak memory {:.0f} MB, before the fit {:.0f} MB; {:.0f} MB where the table is to stay whole\n", fit.n_cells,
               lean, before, peak_memory_mb());
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
  std::vector<std::pair<std::string, brdf::CookTorrance>> models{{"lambertian", {{0.3, 0.4, 0.5}, {}}}, {"one lobe", {{0.05, 0.06, 0.07}, {{{0.1, 0.12, 0.09}, 0.1, 0.4}}}}};
  for (const std::string& name : paint_names) models.emplace_back(name, paint(name));
  fmt::print("paint            noise %  chosen                     next best (criterion)\n");
  for (const double relative : {0.01, 0.05})
    for (const auto& [name, model] : models) {
      const brdf::HalfAngleTable clean = table_of(model);
      brdf::HalfAngleTable table = clean;
      set_noisy(clean, relative, 1, table);
      const fit::FitResult fit = fit::fit_table(table, {.max_cells = max_cells});
      fmt::print("{:<16} {:6g}  {:<26} {} ({:+.4g})   {:.2f} s\n", name, 100 * relative, fit.candidates[0].structure, fit.candidates[1].structure,
                 fit.candidates[1].criterion, fit.seconds);
    }
}

/// The table with these cells alone.
brdf::HalfAngleTable only_chosen(const brdf::HalfAngleTable& table, std::size_t max_cells) {
  brdf::HalfAngleTable chosen = table;
  const fit::UsableCells cells = fit::stratified_choice(fit::usable_cells(table, {}), max_cells);
  for (auto& channel : chosen.channels) {
    channel.origin.assign(brdf::TableGrid::n_cells, brdf::CellOrigin::empty);
    for (const std::uint32_t i : cells.cells) channel.origin[i] = brdf::CellOrigin::measured;
  }
  return chosen;
}

/// How many of `repeats` independent draws with probability `p` are hits, for each of several quantities that may depend on each other.
struct Hits {
  double p;
  std::vector<std::vector<double>> of_repeat;  ///< 0 or 1, by repeat and quantity

  double n() const { return static_cast<double>(of_repeat.size()); }
  double share(std::size_t k) const {
    double sum = 0;
    for (const auto& hits : of_repeat) sum += hits[k];
    return sum / n();
  }
  /// Of all quantities together.
  double share() const {
    double sum = 0;
    for (std::size_t k = 0; k < of_repeat.front().size(); ++k) sum += share(k);
    return sum / static_cast<double>(of_repeat.front().size());
  }
  /// Standard error of that by the scatter of whole repeats, whose quantities depend on each other.
  double share_sigma() const {
    double sum = 0;
    for (const auto& hits : of_repeat) sum += std::pow(std::accumulate(hits.begin(), hits.end(), 0.0) / static_cast<double>(hits.size()) - share(), 2);
    return std::sqrt(sum / (n() - 1) / n());
  }
  /// What chance gives one quantity, 1 sigma.
  double chance() const { return std::sqrt(p * (1 - p) / n()); }
  /// Sum over the quantities of their squared distance from p in units of `chance`: so many as quantities are expected.
  double chi2() const {
    double sum = 0;
    for (std::size_t k = 0; k < of_repeat.front().size(); ++k) sum += std::pow((share(k) - p) / chance(), 2);
    return sum;
  }
  /// Standard deviation of chi2 if all is right: the variance of a sum of squares of normal variables is twice the sum of their squared correlations.
  double chi2_sigma() const {
    double sum = 0;
    const std::size_t size = of_repeat.front().size();
    for (std::size_t a = 0; a < size; ++a)
      for (std::size_t b = 0; b < size; ++b) {
        double both = 0;
        for (const auto& hits : of_repeat) both += (hits[a] - p) * (hits[b] - p);
        sum += std::pow(both / n() / (p * (1 - p)), 2);
      }
    return std::sqrt(2 * sum);
  }
  std::size_t outside(double low, double high) const {
    std::size_t count = 0;
    for (std::size_t k = 0; k < of_repeat.front().size(); ++k) count += share(k) < low || share(k) > high;
    return count;
  }
};

void print_summary(const Hits& hits, double low, double high) {
  const double size = static_cast<double>(hits.of_repeat.front().size());
  const double by_chance = size * (0.5 * std::erfc((hits.p - low) / hits.chance() / std::sqrt(2)) + 0.5 * std::erfc((high - hits.p) / hits.chance() / std::sqrt(2)));
  fmt::print("{:.0f} % intervals: all parameters together {:.2f} % +- {:.2f} (one of {:.0f} repeats scatters by {:.1f}); chi2 over parameters {:.1f}, expected {:.0f} +- {:.1f}; "
             "outside {:.0f}..{:.0f} %: {}, by chance alone {:.1f}\n",
             100 * hits.p, 100 * hits.share(), 100 * hits.share_sigma(), hits.n(), 100 * hits.chance(), hits.chi2(), size, hits.chi2_sigma(), 100 * low,
             100 * high, hits.outside(low, high), by_chance);
}

/// Tables of a paint whose parameters are all within their bounds, with noise of their own: is the truth within the intervals as often as they say?
void coverage(int repeats, std::size_t max_cells) {
  const brdf::CookTorrance truth = paint("ford-f8");
  const brdf::HalfAngleTable clean = only_chosen(table_of(truth), max_cells);
  brdf::HalfAngleTable table = clean;
  const std::vector<double> expected = values_of(truth);
  Hits one{0.68, {}}, two{0.95, {}};
  std::vector<double> largest, sum(expected.size()), squares(expected.size());
  std::vector<fit::Parameter> parameters;
  for (int seed = 1; seed <= repeats; ++seed) {
    set_noisy(clean, noise, static_cast<std::uint64_t>(seed), table);
    const fit::FitResult fit = fit::fit_table(table, {.n_lobes = 3, .n_starts = 2, .model_sigma = 1e-4});
    one.of_repeat.emplace_back(), two.of_repeat.emplace_back();
    for (std::size_t k = 0; k < expected.size(); ++k) {
      const double pull = (fit.parameters[k].value - expected[k]) / fit.parameters[k].sigma;
      one.of_repeat.back().push_back(std::abs(pull) < 0.994458);
      two.of_repeat.back().push_back(std::abs(pull) < 1.959964);
      sum[k] += pull, squares[k] += pull * pull;
    }
    largest.push_back(largest_error(values_of(fit.model), expected));
    parameters = fit.parameters;
  }
  fmt::print("parameter  inside 68 %  inside 95 %  error / sigma: mean   RMS   ({} repeats, {} cells: +- {:.1f}, {:.1f}, {:.2f}, {:.2f})\n", repeats, max_cells,
             100 * one.chance(), 100 * two.chance(), 1 / std::sqrt(repeats), 1 / std::sqrt(2.0 * repeats));
  for (std::size_t k = 0; k < expected.size(); ++k)
    fmt::print("{:<10} {:8.1f}     {:8.1f}              {:+8.2f}  {:6.2f}\n", parameters[k].name, 100 * one.share(k), 100 * two.share(k), sum[k] / repeats,
               std::sqrt(squares[k] / repeats));
  print_summary(one, 0.64, 0.72);
  print_summary(two, 0.93, 0.97);
  std::sort(largest.begin(), largest.end());
  fmt::print("largest error of a parameter: median {:.2f} %, worst repeat {:.2f} %\n", 100 * largest[largest.size() / 2], 100 * largest.back());
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
