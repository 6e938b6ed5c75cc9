#include "libfit/fit.h"

#include <fmt/format.h>
#include <tbb/info.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <chrono>
#include <cmath>

#include "libbrdf/error.h"
#include "libfit/objective.h"
#include "libfit/observations.h"
#include "libfit/solver.h"
#include "libfit/starts.h"
#include "libfit/uncertainty.h"

namespace lacquer::fit {

namespace {

/// Cells of the subset on which starts are found and compared: enough for every parameter, few enough for
/// seconds.
constexpr std::size_t subset_cells = 5000;
/// Relative sigma of the subset's fits at least: far from the minimum a smaller one makes every cell an
/// outlier.
constexpr double subset_sigma = 0.01;
/// Two fits are the same minimum when they agree to this everywhere (mean |ln|).
constexpr double same_minimum = 5e-3;

void check_table(const brdf::HalfAngleTable& table) {
  if (table.channels.size() != 1 && table.channels.size() != 3)
    throw Error(ErrorCode::input,
                fmt::format("table: expected 1 or 3 channels, got {}", table.channels.size()));
  for (const auto& t : table.channels)
    for (const std::size_t size : {t.mean.size(), t.variance.size(), t.theta_h.size(), t.theta_d.size(),
                                   t.phi_d.size(), t.footprint_along.size(), t.footprint_across.size(),
                                   t.footprint_mixed.size(), t.origin.size()})
      if (size != brdf::TableGrid::n_cells)
        throw Error(ErrorCode::input, fmt::format("table: expected {} cells per channel, got {}",
                                                  brdf::TableGrid::n_cells, size));
}

void check_enough(const Observations& observations, const ParameterLayout& layout) {
  const std::size_t needed = 2 * static_cast<std::size_t>(layout.size());
  if (observations.values.size() >= needed) return;
  const LeftOut& out = observations.left_out;
  throw Error(
      ErrorCode::input,
      fmt::format(
          "table: {} usable values are too few for {} parameters, expected at least {} (left out: {} "
          "grazing, "
          "{} not positive, {} not finite, {} not measured); measure more directions or fit fewer lobes",
          observations.values.size(), layout.size(), needed, out.grazing, out.not_positive, out.not_finite,
          out.not_measured));
}

/// |ln(a / b)| of two models over the observations, from log values, which are finite where the models
/// underflow.
struct LogDifference {
  double sum = 0, squares = 0;
  std::size_t n = 0;
  void add(double difference) {
    if (!std::isfinite(difference)) return;  // both or one exactly 0: a channel without data
    sum += std::abs(difference);
    squares += difference * difference;
    ++n;
  }
  double mean() const { return n ? sum / static_cast<double>(n) : 0; }
  double rms() const { return n ? std::sqrt(squares / static_cast<double>(n)) : 0; }
};

bool same_model(const brdf::CookTorrance& a, const brdf::CookTorrance& b, const Observations& observations) {
  LogDifference difference;
  for (const Point& p : observations.points) {
    const glm::dvec3 log_a = a.log_value(p.cosines), log_b = b.log_value(p.cosines);
    for (int c = 0; c < observations.n_channels; ++c) difference.add(log_a[c] - log_b[c]);
  }
  return difference.mean() < same_minimum;
}

/// Refines every start on the subset; distinct minima, best first.
std::vector<Candidate> find_candidates(const Observations& subset, const ParameterLayout& layout,
                                       const ObjectiveOptions& objective_options, const FitOptions& options,
                                       const Progress& progress) {
  const Objective objective(subset, layout, objective_options);
  const auto starts =
      scan_for_starts(subset, options.n_lobes, static_cast<std::size_t>(options.n_starts), options.min_m);
  const double n_values = static_cast<double>(subset.values.size());
  std::vector<Candidate> candidates;
  for (std::size_t i = 0; i < starts.size(); ++i) {
    const Solution solution = minimise(
        objective, layout.pack(starts[i]),
        {.min_m = options.min_m, .max_iterations = options.max_iterations, .function_tolerance = 1e-8});
    candidates.push_back({sorted_by_falling_m(layout.unpack(solution.x)), solution.cost / n_values});
    if (progress) progress("fit", i + 1, static_cast<std::size_t>(options.n_starts) + 1);
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const auto& a, const auto& b) { return a.cost < b.cost; });
  std::vector<Candidate> distinct;
  for (const Candidate& candidate : candidates) {
    const auto same = [&](const Candidate& other) {
      return same_model(candidate.model, other.model, subset);
    };
    if (std::none_of(distinct.begin(), distinct.end(), same)) distinct.push_back(candidate);
  }
  return distinct;
}

void add_errors(const Observations& observations, FitResult& result) {
  LogDifference difference;
  for (const Point& p : observations.points) {
    const glm::dvec3 log_f = result.model.log_value(p.cosines);
    for (std::uint32_t k = p.first; k < p.end; ++k) {
      const Observation& o = observations.values[k];
      if (o.mean > 0) difference.add(log_f[o.channel] - std::log(double{o.mean}));
    }
  }
  result.mean_abs_log = difference.mean();
  result.rms_log = difference.rms();
}

/// kd and ks are proportional to the table's scale, m and r do not depend on it: its error is one more, common term of their covariance.
void add_scale_error(double scale_sigma, FitResult& result) {
  result.scale_sigma = scale_sigma;
  const std::size_t n = result.parameters.size();
  const auto scales = [&](std::size_t i) { return result.parameters[i].name[0] == 'k' && result.parameters[i].sigma > 0; };
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j)
      if (scales(i) && scales(j))
        result.covariance[i * n + j] += scale_sigma * scale_sigma * result.parameters[i].value * result.parameters[j].value;
  for (std::size_t i = 0; i < n; ++i)
    if (scales(i)) result.parameters[i].sigma = std::sqrt(result.covariance[i * n + i]);
}

FitResult fit_checked(const brdf::HalfAngleTable& table, const FitOptions& options,
                      const Progress& progress) {
  const ParameterLayout layout{static_cast<int>(table.channels.size()), options.n_lobes};
  const ObjectiveOptions objective_options{
      .robust_scale = options.robust_scale,
      .energy_weight = table.absolute_scale ? options.energy_weight : 0.0};
  FitResult result;
  result.options = options;
  const std::vector<std::uint32_t> cells = usable_cells(table, options, result.left_out);
  Observations all = observe(table, stratified_choice(cells, options.max_cells), options);
  all.left_out = result.left_out;
  check_enough(all, layout);

  Observations subset =
      observe(table, stratified_choice(cells, std::min(options.max_cells, subset_cells)), options);
  weigh(subset, std::max(options.model_sigma, subset_sigma));
  result.candidates = find_candidates(subset, layout, objective_options, options, progress);

  const std::size_t n_steps = static_cast<std::size_t>(options.n_starts) + 1;
  const brdf::CookTorrance& best = result.candidates.front().model;
  weigh(all, options.model_sigma, &best);
  const Objective objective(all, layout, objective_options);
  const Solution solution = minimise(objective, layout.pack(best),
                                     {.min_m = options.min_m, .max_iterations = options.max_iterations});
  if (progress) progress("fit", n_steps, n_steps);

  result.model = sorted_by_falling_m(layout.unpack(solution.x));
  result.converged = solution.converged;
  result.message = solution.message;
  result.n_cells = all.n_cells;
  result.n_cells_available = cells.size();
  result.n_residuals = all.values.size();
  const glm::dvec3 albedo = normal_incidence_albedo(result.model);
  result.energy = std::max({albedo.x, albedo.y, albedo.z});
  add_uncertainty(objective, layout.pack(result.model), options.min_m, result);
  add_scale_error(table.scale_sigma, result);
  add_errors(all, result);
  return result;
}

}  // namespace

void FitOptions::validate() const {
  const auto require = [](bool good, const std::string& text) {
    if (!good) throw Error(ErrorCode::usage, "fit options: " + text);
  };
  require(n_lobes >= 0 && n_lobes <= 5, fmt::format("n_lobes: expected 0 to 5, got {}", n_lobes));
  require(n_starts >= 1 && n_starts <= 1000, fmt::format("n_starts: expected 1 to 1000, got {}", n_starts));
  require(max_cells >= 1, "max_cells: expected at least 1, got 0");
  require(model_sigma > 0 && std::isfinite(model_sigma),
          fmt::format("model_sigma: expected a positive number, got {}", model_sigma));
  require(min_cosine >= 0 && min_cosine < 1,
          fmt::format("min_cosine: expected 0 <= c < 1, got {}", min_cosine));
  require(min_m >= 1e-4 && min_m < 1, fmt::format("min_m: expected 0.0001 <= m < 1, got {}", min_m));
  require(robust_scale > 0, fmt::format("robust_scale: expected a positive number, got {}", robust_scale));
  require(energy_weight >= 0 && std::isfinite(energy_weight),
          fmt::format("energy_weight: expected 0 or more, got {}", energy_weight));
  require(max_iterations >= 1, fmt::format("max_iterations: expected at least 1, got {}", max_iterations));
}

FitResult fit_table(const brdf::HalfAngleTable& table, const FitOptions& options, const Progress& progress) {
  options.validate();
  check_table(table);
  const auto start = std::chrono::steady_clock::now();
  // More threads than cores gain nothing, and TBB would complain on stderr.
  const int cores = tbb::info::default_concurrency();
  tbb::task_arena arena(
      options.threads == 0 ? cores : std::min(cores, static_cast<int>(std::min(options.threads, 4096u))));
  FitResult result = arena.execute([&] { return fit_checked(table, options, progress); });
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return result;
}

}  // namespace lacquer::fit
