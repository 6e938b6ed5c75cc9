#pragma once

#include <string>
#include <vector>

namespace lacquer::bench {

/// By how much the standard deviation of lacquer's merge (three sums per value) exceeds that of the ideal weights, by formula, no noise
/// drawn: radiances from one electron in the longest exposure to clipping in the shortest, forty to a decade.
struct WeightLoss {
  std::string sensor;
  int frames;
  double decades;          ///< longest over shortest time
  double median, largest;  ///< sigma / ideal sigma - 1
};

std::vector<WeightLoss> weight_losses();

}  // namespace lacquer::bench
