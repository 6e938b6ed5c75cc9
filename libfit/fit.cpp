#include "libfit/fit.h"

#include <fmt/format.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <chrono>
#include <cmath>

#include "libbrdf/error.h"
#include "libfit/group_errors.h"
#include "libfit/log_errors.h"
#include "libfit/objective.h"
#include "libfit/observations.h"
#include "libfit/profile.h"
#include "libfit/selection.h"
#include "libfit/solver.h"
#include "libfit/starts.h"
#include "libfit/uncertainty.h"

namespace lacquer::fit {

namespace {
/// Cells of the subset on which starts are found and compared: enough for every parameter, few enough for
/// seconds.
constexpr std::size_t subset_cells = 5000;
/// Cells on which a fit of many more is brought near its minimum, so that all of them need only the last steps.
constexpr std::size_t middle_cells = 40000;
/// A profile takes some seconds per parameter on many more.
constexpr std::size_t most_cells_profiled = 100000;
/// Up to this many lobes are tried where their number is not given.
constexpr int most_lobes_chosen = 3;
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

void check_enough(const Observations& observations, const LeftOut& out, const ParameterLayout& layout) {
  const std::size_t needed = 2 * static_cast<std::size_t>(layout.size());
  if (observations.n_values >= needed) return;
  throw Error(
      ErrorCode::input,
      fmt::format(
          "table: {} usable values are too few for {} parameters, expected at least {} (left out: {} "
          "grazing, "
          "{} not positive, {} not finite, {} not measured); measure more directions or fit fewer lobes",
          observations.n_values, layout.size(), needed, out.grazing, out.not_positive, out.not_finite,
          out.not_measured));
}

/// Distinct minima of the subset for each structure, best first. Starts are refined side by side; the subset's weights are then those of
/// the best model found.
std::vector<std::vector<Minimum>> find_minima(Observations& subset, double model_sigma, const std::vector<Structure>& structures,
                                              const ObjectiveOptions& objective_options, const FitOptions& options) {
  struct Task {
    std::size_t structure;
    Minimum minimum;
  };
  weigh(subset, model_sigma);
  std::vector<Task> tasks;
  {
    const Scan scan(subset, options.min_m);
    for (std::size_t s = 0; s < structures.size(); ++s)
      for (auto& start : scan.starts(structures[s], static_cast<std::size_t>(options.n_starts), objective_options))
        tasks.push_back({s, {std::move(start)}});
  }
  // Weights taken from the noisy values themselves bias the model, so they only bring it near.
  for (const double damping : {1e-4, 0.0}) {
    tbb::parallel_for(std::size_t{0}, tasks.size(), [&](std::size_t i) {
      const ParameterLayout layout(subset.n_channels, structures[tasks[i].structure]);
      const Objective objective(subset, layout, objective_options);
      const Solution solution = minimise(objective, layout.pack(tasks[i].minimum.model),
                                         {.min_m = options.min_m,
                                          .max_iterations = options.max_iterations,
                                          .function_tolerance = 1e-8,
                                          .insignificant = 1e-3,
                                          .damping = damping,
                                          .ceres = options.ceres});
      tasks[i].minimum = {sorted_by_falling_m(layout.unpack(solution.x)), solution.cost / static_cast<double>(subset.n_values)};
    });
    std::stable_sort(tasks.begin(), tasks.end(), [](const Task& a, const Task& b) { return a.minimum.cost < b.minimum.cost; });
    if (damping > 0) weigh(subset, model_sigma, &tasks.front().minimum.model);
  }
  std::vector<std::vector<Minimum>> distinct(structures.size());
  for (const Task& task : tasks) {
    std::vector<Minimum>& minima = distinct[task.structure];
    const auto same = [&](const Minimum& other) {
      return mean_abs_log_ratio(subset, task.minimum.model, other.model) < same_minimum;
    };
    if (std::none_of(minima.begin(), minima.end(), same)) minima.push_back(task.minimum);
  }
  return distinct;
}

/// SolverOptions::insignificant of the result, and where structures are only compared: 0.01 is nothing beside what a parameter must gain,
/// and spares hundreds of steps along the valleys of a structure that has too much.
constexpr double exact = 1e-6, compared = 0.01;

SolverOptions refinement(const FitOptions& options, double insignificant) {
  return {.min_m = options.min_m,
          .max_iterations = options.max_iterations,
          .function_tolerance = 1e-4 * insignificant,  // ends the creeping along valleys where the model does not fit the paint
          .insignificant = insignificant,
          .damping = 0,
          .ceres = options.ceres};
}

/// Minimum of all cells, with weights that follow the model.
struct Refined {
  Solution solution;
  brdf::CookTorrance model;
};

/// `start`: minimum of the subset. `middle`: fewer cells, or `all`. Sets the weights of both, and `shared`: shared_error.
Refined refine(Observations& middle, Observations& all, const ParameterLayout& layout, const brdf::CookTorrance& start,
               const ObjectiveOptions& objective_options, const FitOptions& options, double last_insignificant, double& shared) {
  Refined refined{.solution = {}, .model = start};
  const auto weigh_by_model = [&](Observations& cells) {
    weigh(cells, options.model_sigma, &refined.model);
    if (shared > 0) limit_groups(cells, shared);
  };
  const auto round = [&](Observations& cells, double insignificant) {
    shared = 0;
    weigh_by_model(cells);
    if (options.limit_groups) shared = shared_error(cells, refined.model);
    if (shared > 0) limit_groups(cells, shared);
    const Objective objective(cells, layout, objective_options);
    refined.solution = minimise(objective, layout.pack(refined.model), refinement(options, insignificant));
    refined.model = sorted_by_falling_m(layout.unpack(refined.solution.x));
  };
  const bool all_at_once = &middle == &all;
  round(middle, all_at_once ? 1.0 : compared);  // the first weights are not worth more than a sigma
  round(all, last_insignificant);
  if (!all_at_once) weigh_by_model(middle);
  return refined;
}

/// Brings the winner from where it could be compared to where its parameters are exact.
void polish(const Observations& all, const ObjectiveOptions& objective_options, const FitOptions& options, Trial& trial) {
  const Objective objective(all, ParameterLayout(all.n_channels, trial.structure), objective_options);
  trial.solution = minimise(objective, objective.layout().pack(trial.model), refinement(options, exact));
  trial.model = objective.layout().unpack(trial.solution.x);
  sort_by_falling_m(trial);
}

/// The trials for people, and the errors of the first one into `result`.
void add_candidates(const std::vector<Trial>& trials, const Observations& all, FitResult& result) {
  for (const Trial& trial : trials) {
    const LogErrors errors = log_errors(all, trial.model);
    if (&trial == &trials.front()) result.mean_abs_log = errors.mean, result.rms_log = errors.rms;
    result.candidates.push_back({.model = trial.model,
                          .structure = to_text(trial.structure),
                          .n_parameters = ParameterLayout(all.n_channels, trial.structure).size(),
                          .cost = trial.solution.cost / static_cast<double>(all.n_values),
                          .mean_abs_log = errors.mean,
                                 .criterion = trial.criterion - trials.front().criterion});
  }
}

/// The model of `chosen` with its parameters and errors into `result`.
GroupedQuadratics add_errors(const Observations& all, const ObjectiveOptions& objective_options, const FitOptions& options, const Trial& chosen,
                             FitResult& result) {
  const ParameterLayout layout(all.n_channels, chosen.structure);
  const std::vector<double> x = layout.pack(chosen.model);
  GroupedQuadratics quadratics = grouped_quadratics(Objective(all, layout, objective_options), x);
  result.model = chosen.model;
  add_uncertainty(layout, x, quadratics, all.n_values, options.min_m, result);
  return quadratics;
}

/// What the choice of structure sees of a table.
struct Cells {
  Observations &subset, &middle, &all;
};

/// Chooses the structure: all trials, the chosen one first. `richest`: of the most lobes, on all cells.
std::vector<Trial> choose(const Cells& cells, std::vector<Trial> by_lobes, const Refined& richest, const ObjectiveOptions& objective_options,
                          const FitOptions& options, FitResult& result) {
  by_lobes.back().model = richest.model;
  by_lobes.back().solution = richest.solution;
  const GroupedQuadratics quadratics = add_errors(cells.all, objective_options, options, by_lobes.back(), result);
  const ParameterLayout layout(cells.all.n_channels, by_lobes.back().structure);
  result.overdispersion = overdispersion(layout, layout.pack(richest.model), quadratics, cells.all.n_values);
  const int most_lobes = by_lobes.back().structure.n_lobes;
  Selection selection(cells.subset, cells.middle, cells.all, objective_options, refinement(options, compared), options.other_forms, result.overdispersion);
  result.parameter_price = selection.penalty(1);
  std::vector<Trial> trials = selection.compare(by_lobes);
  // Where the model does not follow the paint anyway, its lobes approximate together and none of them is a claim.
  const auto has_a_lobe_too_many = [&] {
    const int n_lobes = trials.front().structure.n_lobes;
    return result.shared_error == 0 && n_lobes > 0 && !every_lobe_shows(result);
  };
  // Of the paper's forms first: a lobe that does not show is not worth trying other forms on it.
  bool has_errors_of_front = trials.front().structure.n_lobes == most_lobes;
  while (result.shared_error == 0 && trials.front().structure.n_lobes > 0) {
    if (!has_errors_of_front) add_errors(cells.all, objective_options, options, trials.front(), result);
    has_errors_of_front = false;
    if (!has_a_lobe_too_many()) break;
    selection.put_best_first(trials, trials.front().structure.n_lobes - 1);
  }
  int limit = trials.front().structure.n_lobes;
  for (;;) {
    selection.settle(trials, limit);
    polish(cells.all, objective_options, options, trials.front());
    add_errors(cells.all, objective_options, options, trials.front(), result);
    if (!has_a_lobe_too_many()) return trials;
    limit = trials.front().structure.n_lobes - 1;
  }
}

/// Frees what is not asked for once places are known.
void free_places(brdf::HalfAngleTable& table) {
  for (brdf::TableChannel& t : table.channels) {
    t.count = std::vector<std::uint32_t>();
    for (auto* values : {&t.theta_h, &t.theta_d, &t.phi_d, &t.footprint_along, &t.footprint_across, &t.footprint_mixed}) *values = std::vector<float>();
  }
}

/// `freed`: null, or the table itself, whose places are freed.
FitResult fit_checked(const brdf::HalfAngleTable& table, brdf::HalfAngleTable* freed, const FitOptions& options, const Progress& progress) {
  constexpr std::size_t n_steps = 4;
  const auto step_done = [&](std::size_t step) {
    if (progress) progress("fit", step, n_steps);
  };
  const int n_channels = static_cast<int>(table.channels.size());
  const ObjectiveOptions objective_options{
      .robust_scale = options.robust_scale,
      .energy_weight = table.absolute_scale ? options.energy_weight : 0.0};
  std::vector<Structure> structures;
  for (int n = options.n_lobes.value_or(0); n <= options.n_lobes.value_or(most_lobes_chosen); ++n) structures.push_back({.n_lobes = n});

  FitResult result;
  result.options = options;
  UsableCells usable = usable_cells(table, options);
  result.left_out = usable.left_out;
  result.n_cells_available = usable.cells.size();
  Observations subset = observe(table, stratified_choice(usable, std::min(options.max_cells, subset_cells)));
  std::optional<Observations> fewer;
  if (std::min(options.max_cells, usable.cells.size()) > 2 * middle_cells) fewer = observe(table, stratified_choice(usable, middle_cells));
  if (usable.cells.size() > options.max_cells) usable = stratified_choice(usable, options.max_cells);
  Observations all = observe(table, std::move(usable));
  if (freed) free_places(*freed);
  while (!options.n_lobes && structures.size() > 1 &&
         all.n_values < 2 * static_cast<std::size_t>(ParameterLayout(n_channels, structures.back()).size()))
    structures.pop_back();
  check_enough(all, result.left_out, ParameterLayout(n_channels, structures.back()));
  Observations& middle = fewer ? *fewer : all;
  step_done(1);
  const auto minima = find_minima(subset, std::max(options.model_sigma, subset_sigma), structures, objective_options, options);
  step_done(2);

  const ParameterLayout richest(n_channels, structures.back());
  const Refined refined = refine(middle, all, richest, minima.back().front().model, objective_options, options,
                                 options.n_lobes ? exact : compared, result.shared_error);
  step_done(3);
  std::vector<Trial> trials;
  for (std::size_t s = 0; s < structures.size(); ++s) trials.push_back({structures[s], minima[s].front().model, {}});
  if (options.n_lobes) {
    trials = {{structures.back(), refined.model, refined.solution}};
    add_errors(all, objective_options, options, trials.front(), result);
  } else {
    trials = choose({subset, middle, all}, std::move(trials), refined, objective_options, options, result);
  }
  const Trial& chosen = trials.front();
  const ParameterLayout layout(n_channels, chosen.structure);
  result.minima = minima[static_cast<std::size_t>(chosen.structure.n_lobes - structures.front().n_lobes)];
  add_candidates(trials, all, result);
  result.converged = chosen.solution.converged;
  result.message = chosen.solution.message;
  result.n_cells = all.n_cells;
  result.n_residuals = all.n_values;
  result.n_bounds = all.n_bounds;
  const glm::dvec3 albedo = normal_incidence_albedo(result.model);
  result.energy = std::max({albedo.x, albedo.y, albedo.z});
  if (options.profile || all.n_cells <= most_cells_profiled)
    add_profiles(Objective(all, layout, objective_options), layout.pack(result.model), refinement(options, exact),
                 options.profile ? Profiled::all : Profiled::misleading, result);
  add_half_vector_error(options.half_vector_sigma, result);
  add_scale_error(table.scale_sigma, result);
  step_done(4);
  return result;
}

}  // namespace

void FitOptions::validate() const {
  const auto require = [](bool good, const std::string& text) {
    if (!good) throw Error(ErrorCode::usage, "fit options: " + text);
  };
  if (n_lobes) require(*n_lobes >= 0 && *n_lobes <= max_lobes, fmt::format("n_lobes: expected 0 to {}, got {}", max_lobes, *n_lobes));
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
  require(half_vector_sigma >= 0 && half_vector_sigma < 1, fmt::format("half_vector_sigma: expected 0 to 1 rad, got {}", half_vector_sigma));
  require(max_iterations >= 1, fmt::format("max_iterations: expected at least 1, got {}", max_iterations));
}

namespace {

FitResult fit_timed(const brdf::HalfAngleTable& table, brdf::HalfAngleTable* freed, const FitOptions& options, const Progress& progress) {
  options.validate();
  check_table(table);
  const auto start = std::chrono::steady_clock::now();
  // More threads than cores gain nothing, and TBB would complain on stderr.
  const int cores = tbb::info::default_concurrency();
  tbb::task_arena arena(
      options.threads == 0 ? cores : std::min(cores, static_cast<int>(std::min(options.threads, 4096u))));
  FitResult result = arena.execute([&] { return fit_checked(table, freed, options, progress); });
  result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return result;
}

}  // namespace

FitResult fit_table(const brdf::HalfAngleTable& table, const FitOptions& options, const Progress& progress) {
  return fit_timed(table, nullptr, options, progress);
}

FitResult fit_and_free_places(brdf::HalfAngleTable& table, const FitOptions& options, const Progress& progress) {
  return fit_timed(table, &table, options, progress);
}

}  // namespace lacquer::fit
