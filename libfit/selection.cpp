#include "libfit/selection.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "libfit/group_errors.h"

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

Selection::Selection(const Observations& subset, const Observations& middle, const Observations& all, const ObjectiveOptions& objective,
                     const SolverOptions& solver, bool other_forms, double overdispersion)
    : subset_(subset), middle_(middle), all_(all), objective_(objective), solver_(solver), other_forms_(other_forms),
      overdispersion_(overdispersion), share_(static_cast<double>(all.n_values) / static_cast<double>(subset.n_values)) {
  if (&middle != &all) middle_share_ = total_weight(all) / total_weight(middle);
}

double Selection::penalty(int n) const {
  return n * std::log(std::max(2.0, static_cast<double>(all_.n_values) / overdispersion_));
}

double Selection::criterion(double cost, const Structure& structure) const {
  return cost / overdispersion_ + penalty(n_parameters(all_.n_channels, structure));
}

Solution Selection::solved(const Observations& observations, const Structure& structure, const brdf::CookTorrance& start) const {
  const Objective objective = this->objective(observations, structure);
  return minimise(objective, objective.layout().pack(start), solver_);
}

Trial Selection::refined(const Structure& structure, const brdf::CookTorrance& start) const {
  Trial trial{.structure = structure, .model = {}, .solution = solved(all_, structure, start)};
  trial.model = ParameterLayout(all_.n_channels, structure).unpack(trial.solution.x);
  trial.criterion = criterion(trial.solution.cost, structure);
  sort_by_falling_m(trial);
  return trial;
}

std::vector<Trial> Selection::varied(const Trial& trial) const {
  std::vector<Variation> variations;
  for (const Structure& structure : without_one_thing(trial.structure, all_.n_channels)) variations.push_back({structure, trial.model});
  if (other_forms_)
    for (Variation& v : with_other_forms(trial.structure, trial.model)) variations.push_back(std::move(v));
  // Fewer cells tell what is not worth more. What they promise is off by chance; what adds something must at least promise a gain.
  const auto sieve = [&](const Observations& observations, double share) {
    const double full = solved(observations, trial.structure, trial.model).cost;
    std::vector<Solution> solutions(variations.size());
    tbb::parallel_for(std::size_t{0}, variations.size(),
                      [&](std::size_t i) { solutions[i] = solved(observations, variations[i].structure, variations[i].start); });
    std::vector<Variation> left;
    for (std::size_t i = 0; i < variations.size(); ++i) {
      const Structure& structure = variations[i].structure;
      const double loss = (solutions[i].cost - full) * share / overdispersion_;
      const int saved = n_parameters(all_.n_channels, trial.structure) - n_parameters(all_.n_channels, structure);
      if (loss > (saved > 0 ? hopeless * penalty(saved) : penalty(saved))) continue;
      left.push_back({structure, ParameterLayout(all_.n_channels, structure).unpack(solutions[i].x)});
    }
    variations = std::move(left);
  };
  sieve(subset_, share_);
  if (&middle_ != &all_ && !variations.empty()) sieve(middle_, middle_share_);
  std::vector<Trial> trials;
  for (const Variation& v : variations) trials.push_back(refined(v.structure, v.start));
  return trials;
}

std::vector<Trial> Selection::compare(const std::vector<Trial>& by_lobes) const {
  const Trial& richest = by_lobes.back();
  const bool fewer = &middle_ != &all_;
  const double richest_cost = fewer ? solved(middle_, richest.structure, richest.model).cost : richest.solution.cost;
  std::vector<Trial> trials;
  for (const Trial& from : by_lobes) {
    Trial trial = from;
    if (&from != &richest) {
      const Solution near = solved(middle_, from.structure, from.model);
      trial.model = ParameterLayout(all_.n_channels, from.structure).unpack(near.x);
      const int saved = n_parameters(all_.n_channels, richest.structure) - n_parameters(all_.n_channels, from.structure);
      if ((near.cost - richest_cost) * middle_share_ / overdispersion_ < hopeless * penalty(saved)) {
        trial = refined(from.structure, trial.model);
      } else {  // far worse: need not be exact
        trial.solution = near;
        if (fewer) trial.solution.cost = objective(all_, from.structure).cost(near.x);
      }
    }
    trial.criterion = criterion(trial.solution.cost, trial.structure);
    sort_by_falling_m(trial);
    trials.push_back(std::move(trial));
  }
  put_best_first(trials, most_lobes);
  return trials;
}

void Selection::put_best_first(std::vector<Trial>& trials, int n_lobes) const {
  std::stable_sort(trials.begin(), trials.end(), [](const Trial& a, const Trial& b) { return a.criterion < b.criterion; });
  const auto best = std::find_if(trials.begin(), trials.end(), [&](const Trial& t) { return t.structure.n_lobes <= n_lobes; });
  std::rotate(trials.begin(), best, best + 1);
}

void Selection::settle(std::vector<Trial>& trials, int n_lobes) const {
  put_best_first(trials, n_lobes);
  for (;;) {
    const Structure winner = trials.front().structure;
    for (Trial& other : varied(trials.front()))
      if (std::none_of(trials.begin(), trials.end(), [&](const Trial& t) { return t.structure == other.structure; }))
        trials.push_back(std::move(other));
    put_best_first(trials, n_lobes);
    if (trials.front().structure == winner) return;
  }
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
