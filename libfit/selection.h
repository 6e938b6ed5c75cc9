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

/// Chooses how many lobes, whether their colours differ from grey and whether there is a diffuse part.
class Selection {
 public:
  /// `subset`, `all`: the same table, fewer cells and all that are used, weighed alike for every structure.
  Selection(const Observations& subset, const Observations& all, const ObjectiveOptions& objective, const SolverOptions& solver,
            bool other_forms)
      : subset_(subset), all_(all), objective_(objective), solver_(solver), other_forms_(other_forms) {}

  /// Compares the numbers of lobes by their best models on the subset (`by_lobes`, fewest first, the last one the richest), then leaves
  /// out of the winner what is not needed and, with `other_forms`, tries GGX and exact Fresnel lobe by lobe. All trials, best first. `richest`: solution of the last one on all cells.
  std::vector<Trial> choose(const std::vector<Trial>& by_lobes, const Solution& richest);

  /// Puts the best trial of at most so many lobes first, after trying what may be better still; the rest by rising criterion.
  void settle(std::vector<Trial>& trials, int n_lobes) const;

  double overdispersion() const { return overdispersion_; }
  /// What `n` parameters must gain.
  double penalty(int n) const;

 private:
  Objective objective(const Observations& observations, const Structure& structure) const {
    return {observations, ParameterLayout(observations.n_channels, structure), objective_};
  }
  double criterion(double cost, const Structure& structure) const;
  Trial refined(const Structure& structure, const brdf::CookTorrance& start) const;
  /// The structures that differ from `trial` by one thing and may be better.
  std::vector<Trial> varied(const Trial& trial) const;

  const Observations &subset_, &all_;
  ObjectiveOptions objective_;
  SolverOptions solver_;
  bool other_forms_;
  double overdispersion_ = 1;
};

/// E.g. "2 lobes, lobe 2 grey, no diffuse part".
std::string to_text(const Structure& structure);

}  // namespace lacquer::fit
