#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "libbrdf/cook_torrance.h"
#include "libfit/objective.h"
#include "libfit/observations.h"

namespace lacquer::fit {

/// Starting models without luck.
///
/// For given m the model is linear with non-negative coefficients: ks (r + (1 - r) s) = (ks r) 1 + (ks (1 - r)) s with Schlick's weight
/// s, so every lobe is two columns, lobe(m, r = 1) and lobe(m, r = 0). The Gram matrix of all columns on a grid of m is summed once;
/// each choice of grid values is then a tiny non-negative least-squares problem per channel. No random numbers; m in [min_m, 1].
class Scan {
 public:
  /// Keeps a reference to the observations.
  Scan(const Observations& observations, double min_m);
  ~Scan();

  /// At most `count` models, apart from each other in m, the one of the lowest objective first.
  std::vector<brdf::CookTorrance> starts(const Structure& structure, std::size_t count, const ObjectiveOptions& options) const;

 private:
  struct Tables;
  const Observations* observations_;
  std::unique_ptr<Tables> tables_;
};

}  // namespace lacquer::fit
