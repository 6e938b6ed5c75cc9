#include "libfit/selection.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "libfit/uncertainty.h"

namespace lacquer::fit {

namespace {

/// A structure whose predicted loss is this many times what its fewer parameters save is not refined on all cells.
constexpr double hopeless = 10;
constexpr int most_lobes = max_lobes;

/// Other forms than the paper's must gain as much as a parameter each.
int n_parameters(int n_channels, const Structure& structure) {
  int n = ParameterLayout(n_channels, structure).size();
  for (std::size_t l = 0; l < static_cast<std::size_t>(structure.n_lobes); ++l)
    n += (structure.distribution[l] != brdf::Distribution::beckmann) + (structure.fresnel[l] != brdf::Fresnel::schlick);
  return n;
}

bool usual_forms(const Structure& structure) {
  return structure.distribution == Structure{}.distribution && structure.fresnel == Structure{}.fresnel;
}

/// A structure with a model to start from.
struct Variation {
  Structure structure;
  brdf::CookTorrance start;
};

/// A GGX lobe falls to half its height at sqrt(sqrt(2) - 1) m, a Beckmann lobe at sqrt(ln 2) m.
constexpr double ggx_width = 1.2936;

/// One lobe with GGX or with a dielectric's reflectance; once a lobe has such a form, also models without one of the lobes, which it may
/// have replaced.
std::vector<Variation> with_other_forms(const Structure& structure, const brdf::CookTorrance& model) {
  std::vector<Variation> variations;
  for (std::size_t l = 0; l < model.lobes.size(); ++l) {
    if (structure.distribution[l] == brdf::Distribution::beckmann) {
      Variation& v = variations.emplace_back(Variation{structure, model});
      v.structure.distribution[l] = brdf::Distribution::ggx;
      v.start.lobes[l].m = std::min(1.0, model.lobes[l].m * ggx_width);
    }
    if (structure.fresnel[l] == brdf::Fresnel::schlick) variations.emplace_back(Variation{structure, model}).structure.fresnel[l] = brdf::Fresnel::dielectric;
  }
  if (usual_forms(structure)) return variations;
  for (std::size_t l = 0; l < model.lobes.size(); ++l) {
    Variation& v = variations.emplace_back(Variation{structure, model});
    --v.structure.n_lobes;
    v.start.lobes.erase(v.start.lobes.begin() + static_cast<std::ptrdiff_t>(l));
    for (std::size_t k = l; k + 1 < max_lobes; ++k) {
      v.structure.grey[k] = structure.grey[k + 1];
      v.structure.distribution[k] = structure.distribution[k + 1];
      v.structure.fresnel[k] = structure.fresnel[k + 1];
    }
    v.structure.grey.back() = false;
    v.structure.distribution.back() = {};
    v.structure.fresnel.back() = {};
  }
  return variations;
}

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
    trial.structure.distribution[l] = before.structure.distribution[order[l]];
    trial.structure.fresnel[l] = before.structure.fresnel[order[l]];
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

std::vector<Trial> Selection::varied(const Trial& trial) const {
  const double share = static_cast<double>(all_.n_values) / static_cast<double>(subset_.n_values);
  const auto on_subset = [&](const Structure& structure, const brdf::CookTorrance& start) {
    const Objective objective = this->objective(subset_, structure);
    return minimise(objective, objective.layout().pack(start), solver_);
  };
  const double full = on_subset(trial.structure, trial.model).cost;
  std::vector<Variation> variations;
  for (const Structure& structure : without_one_thing(trial.structure, all_.n_channels)) variations.push_back({structure, trial.model});
  if (other_forms_)
    for (Variation& v : with_other_forms(trial.structure, trial.model)) variations.push_back(std::move(v));
  std::vector<Solution> solutions(variations.size());
  tbb::parallel_for(std::size_t{0}, variations.size(),
                    [&](std::size_t i) { solutions[i] = on_subset(variations[i].structure, variations[i].start); });
  std::vector<Trial> trials;
  for (std::size_t i = 0; i < variations.size(); ++i) {
    const Structure& structure = variations[i].structure;
    const double loss = (solutions[i].cost - full) * share / overdispersion_;
    const int saved = n_parameters(all_.n_channels, trial.structure) - n_parameters(all_.n_channels, structure);
    // What the subset promises is off by chance; what adds something must at least promise a gain there.
    if (loss > (saved > 0 ? hopeless * penalty(saved) : penalty(saved))) continue;
    trials.push_back(refined(structure, ParameterLayout(all_.n_channels, structure).unpack(solutions[i].x)));
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
  settle(trials, most_lobes);
  return trials;
}

void Selection::settle(std::vector<Trial>& trials, int n_lobes) const {
  const auto best = [&] {
    const Trial* least = nullptr;
    for (const Trial& t : trials)
      if (t.structure.n_lobes <= n_lobes && (!least || t.criterion < least->criterion)) least = &t;
    return *least;
  };
  Trial winner = best();
  for (;;) {
    for (Trial& other : varied(winner))
      if (std::none_of(trials.begin(), trials.end(), [&](const Trial& t) { return t.structure == other.structure; }))
        trials.push_back(std::move(other));
    const Trial next = best();
    if (next.structure == winner.structure) break;
    winner = next;
  }
  std::stable_sort(trials.begin(), trials.end(), [](const Trial& a, const Trial& b) { return a.criterion < b.criterion; });
  std::stable_partition(trials.begin(), trials.end(), [&](const Trial& t) { return t.structure == winner.structure; });
}

std::string to_text(const Structure& structure) {
  std::string text = fmt::format("{} lobe{}", structure.n_lobes, structure.n_lobes == 1 ? "" : "s");
  for (int l = 0; l < structure.n_lobes; ++l)
    if (structure.grey[static_cast<std::size_t>(l)]) text += fmt::format(", lobe {} grey", l + 1);
  for (int l = 0; l < structure.n_lobes; ++l) {
    if (structure.distribution[static_cast<std::size_t>(l)] == brdf::Distribution::ggx) text += fmt::format(", lobe {} GGX", l + 1);
    if (structure.fresnel[static_cast<std::size_t>(l)] == brdf::Fresnel::dielectric) text += fmt::format(", lobe {} dielectric", l + 1);
  }
  if (!structure.diffuse) text += ", no diffuse part";
  return text;
}

}  // namespace lacquer::fit
