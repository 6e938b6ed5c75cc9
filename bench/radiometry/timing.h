#pragma once

#include <algorithm>
#include <chrono>
#include <vector>

namespace lacquer::bench {

struct Timing {
  double min_s = 0, median_s = 0;
  int repeats = 0;
};

/// Wall-clock time of `work()`, whose result must reach something that is looked at later.
template <typename Work>
Timing time_repeats(int repeats, const Work& work) {
  std::vector<double> seconds;
  for (int i = 0; i < repeats; ++i) {
    const auto start = std::chrono::steady_clock::now();
    work();
    seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  }
  std::sort(seconds.begin(), seconds.end());
  return {seconds.front(), seconds[seconds.size() / 2], repeats};
}

}  // namespace lacquer::bench
