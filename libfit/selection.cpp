#include "libfit/selection.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "libfit/uncertainty.h"

namespace lacquer::fit {

namespace {

/// A structure whose predicted loss is this many times what its fewer parameters save is not refined on all cells.
constexpr double hopeless = 10;

int n_parameters(int n_channels, const Structure& structure) { return ParameterLayout(n_channels, structure).size(); }

/// The structures that leave out one thing; black stays in, so that there is a model.
std::vector<Structure> without_one_thing(const Structure& structure, int n_channels) {
  std::vector<Structure> simpler;
  for (std::size_t l = 0; n_channels > 1 && l < static_cast<std::size_t>(structure.n_lobes); ++l) {
    if (structure.grey[l]) continue;
    simpler.push_back(structure);
    simpler.back().grey[l] = true;
  }
  if (structure.diffuse && structure.n_lobes > 0) {
    simpler.push_back(structure);
    simpler.back().diffuse = false;
  }
  return simpler;
}

}  // namespace

void sort_by_falling_m(Trial& trial) {
  std::vector<std::size_t> order(trial.model.lobes.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) { return trial.model.lobes[a].m > trial.model.lobes[b].m; });
  const Trial before = trial;
  for (std::size_t l = 0; l < order.size(); ++l) {
    trial.model.lobes[l] = before.model.lobes[order[l]];
    trial.structure.grey[l] = before.structure.grey[order[l]];
  }
}

double Selection::penalty(int n) const {
  return n * std::log(std::max(2.0, static_cast<double>(all_.n_values) / overdispersion_));
}

double Selection::criterion(double cost, const Structure& structure) const {
  return cost / overdispersion_ + penalty(n_parameters(all_.n_channels, structure));
}

Trial Selection::refined(const Structure& structure, const brdf::CookTorrance& start) const {
  const Objective objective = this->objective(all_, structure);
  Trial trial{.structure = structure, .model = {}, .solution = minimise(objective, objective.layout().pack(start), solver_)};
  trial.model = objective.layout().unpack(trial.solution.x);
  trial.criterion = criterion(trial.solution.cost, structure);
  sort_by_falling_m(trial);
  return trial;
}

std::vector<Trial> Selection::simplified(const Trial& trial) const {
  const double share = static_cast<double>(all_.n_values) / static_cast<double>(subset_.n_values);
  const auto on_subset = [&](const Structure& structure) {
    const Objective objective = this->objective(subset_, structure);
    return std::pair(minimise(objective, objective.layout().pack(trial.model), solver_), objective);
  };
  const auto [full, ignored] = on_subset(trial.structure);
  std::vector<Trial> trials;
  for (const Structure& structure : without_one_thing(trial.structure, all_.n_channels)) {
    const auto [solution, objective] = on_subset(structure);
    const double loss = (solution.cost - full.cost) * share / overdispersion_;
    const int saved = n_parameters(all_.n_channels, trial.structure) - objective.layout().size();
    if (loss > hopeless * penalty(saved)) continue;
    trials.push_back(refined(structure, objective.layout().unpack(solution.x)));
  }
  return trials;
}

std::vector<Trial> Selection::choose(const std::vector<Trial>& by_lobes, const Solution& richest) {
  const Structure& full = by_lobes.back().structure;
  const Objective richest_objective = objective(all_, full);
  overdispersion_ =
      fit::overdispersion(richest_objective.layout(), richest.x, grouped_quadratics(richest_objective, richest.x), all_.n_values);
  std::vector<Trial> trials;
  for (const Trial& from : by_lobes) {
    Trial trial = from;
    if (from.structure == full) {
      trial.solution = richest;
      trial.model = richest_objective.layout().unpack(richest.x);
      sort_by_falling_m(trial);
    } else {
      const Objective objective = this->objective(all_, from.structure);
      trial.solution = {.x = objective.layout().pack(from.model)};
      trial.solution.cost = objective.cost(trial.solution.x);
      const int saved = n_parameters(all_.n_channels, full) - objective.layout().size();
      // A model of the subset is off by its errors, which cost about its parameters' number times the cells per cell of the subset. What
      // is worse by far stays so.
      const double share = static_cast<double>(all_.n_values) / static_cast<double>(subset_.n_values);
      const double loss = (trial.solution.cost - richest.cost) / overdispersion_;
      if (loss < hopeless * (penalty(saved) + share * objective.layout().size())) trial = refined(from.structure, from.model);
    }
    trial.criterion = criterion(trial.solution.cost, trial.structure);
    trials.push_back(std::move(trial));
  }
  const auto best = [&] {
    return *std::min_element(trials.begin(), trials.end(), [](const Trial& a, const Trial& b) { return a.criterion < b.criterion; });
  };
  for (Trial winner = best();;) {
    const std::vector<Trial> simpler = simplified(winner);
    trials.insert(trials.end(), simpler.begin(), simpler.end());
    const Trial next = best();
    if (next.structure == winner.structure) break;
    winner = next;
  }
  std::stable_sort(trials.begin(), trials.end(), [](const Trial& a, const Trial& b) { return a.criterion < b.criterion; });
  return trials;
}

std::string to_text(const Structure& structure) {
  std::string text = fmt::format("{} lobe{}", structure.n_lobes, structure.n_lobes == 1 ? "" : "s");
  for (int l = 0; l < structure.n_lobes; ++l)
    if (structure.grey[static_cast<std::size_t>(l)]) text += fmt::format(", lobe {} grey", l + 1);
  if (!structure.diffuse) text += ", no diffuse part";
  return text;
}

}  // namespace lacquer::fit
