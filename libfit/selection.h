#pragma once

#include <functional>
#include <string>
#include <vector>

#include "libfit/fit.h"
#include "libfit/objective.h"
#include "libfit/parameters.h"
#include "libfit/solver.h"

namespace lacquer::fit {

/// A structure with its best model.
struct Trial {
  Structure structure;
  brdf::CookTorrance model;
  Solution solution;     ///< on all cells
  double criterion = 0;  ///< as in Candidate, not relative
};

/// Same lobes, ordered by falling m, with their colours.
void sort_by_falling_m(Trial& trial);

/// Compares how many lobes, whether their colours differ from grey, whether there is a diffuse part and what forms the lobes have.
class Selection {
 public:
  /// `subset`, `middle`, `all`: the same table, ever more cells and all that are used, weighed alike for every structure; `middle` may be
  /// `all`. `overdispersion`: see uncertainty.h.
  Selection(const Observations& subset, const Observations& middle, const Observations& all, const ObjectiveOptions& objective,
            const SolverOptions& solver, bool other_forms, double overdispersion);

  /// Trials of the numbers of lobes, fewest first, with their best models on the subset; the last one, the richest, with its solution on
  /// all cells. All of them, by rising criterion.
  std::vector<Trial> compare(const std::vector<Trial>& by_lobes) const;

  /// Puts the best trial of at most so many lobes first; the rest by rising criterion.
  void put_best_first(std::vector<Trial>& trials, int n_lobes) const;

  /// The same after trying what may be better still: leaves out what is not needed and, with `other_forms`, tries GGX and exact Fresnel
  /// lobe by lobe.
  void settle(std::vector<Trial>& trials, int n_lobes) const;

  /// What `n` parameters must gain.
  double penalty(int n) const;

 private:
  Objective objective(const Observations& observations, const Structure& structure) const {
    return {observations, ParameterLayout(observations.n_channels, structure), objective_};
  }
  double criterion(double cost, const Structure& structure) const;
  Solution solved(const Observations& observations, const Structure& structure, const brdf::CookTorrance& start) const;
  Trial refined(const Structure& structure, const brdf::CookTorrance& start) const;
  /// The structures that differ from `trial` by one thing and may be better.
  std::vector<Trial> varied(const Trial& trial) const;

  const Observations &subset_, &middle_, &all_;
  ObjectiveOptions objective_;
  SolverOptions solver_;
  bool other_forms_;
  double overdispersion_;
  double share_ = 1, middle_share_ = 1;  ///< what all cells count beside the subset and `middle`
};

/// E.g. "2 lobes, lobe 2 grey, no diffuse part".
std::string to_text(const Structure& structure);

}  // namespace lacquer::fit
