#include "bench/radiometry/machine.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include <cstring>
#include <fstream>
#include <functional>
#include <thread>

namespace lacquer::bench {

namespace {

/// A result that the compiler must believe somebody reads.
volatile std::uint64_t sink;

constexpr std::size_t words_per_task = 1 << 15;  // 256 KiB

std::uint64_t sum_of(const std::vector<std::uint64_t>& data) {
  return tbb::parallel_reduce(
      tbb::blocked_range<std::size_t>(0, data.size(), words_per_task), std::uint64_t{0},
      [&](const tbb::blocked_range<std::size_t>& range, std::uint64_t sum) {
        for (std::size_t i = range.begin(); i < range.end(); ++i) sum += data[i];  // vectorises
        return sum;
      },
      std::plus<>());
}

}  // namespace

Machine describe_machine() {
  Machine machine{"unknown processor", static_cast<int>(std::thread::hardware_concurrency())};
  std::ifstream info("/proc/cpuinfo");
  for (std::string line; std::getline(info, line);)
    if (line.starts_with("model name")) {
      machine.cpu = line.substr(line.find(':') + 2);
      break;
    }
  return machine;
}

MemoryLimits measure_memory(std::size_t n_values, int repeats) {
  MemoryLimits limits;
  limits.n_values = static_cast<double>(n_values);
  std::vector<std::uint64_t> wide(n_values / 4 + 1), copy(wide.size());
  tbb::parallel_for(std::size_t{0}, wide.size(), [&](std::size_t i) { wide[i] = i; });
  limits.read_16bit = time_repeats(repeats, [&] { sink = sum_of(wide); });
  limits.copy = time_repeats(repeats, [&] {
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, wide.size(), words_per_task), [&](const tbb::blocked_range<std::size_t>& r) {
      std::memcpy(&copy[r.begin()], &wide[r.begin()], r.size() * sizeof(std::uint64_t));
    });
    sink = copy.back();
  });
  wide.resize(n_values / 8 + 1);
  limits.read_8bit = time_repeats(repeats, [&] { sink = sum_of(wide); });
  return limits;
}

}  // namespace lacquer::bench
