#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "bench/radiometry/timing.h"

namespace lacquer::bench {

struct Machine {
  std::string cpu;
  int cores = 0;
};

Machine describe_machine();

/// What memory allows, all cores.
struct MemoryLimits {
  Timing read_8bit;   ///< every byte of the stack once, one byte per value
  Timing read_16bit;  ///< the same, two bytes per value (as RawFrame holds it)
  double n_values = 0;
  Timing copy;        ///< memcpy of the 16-bit stack
};

MemoryLimits measure_memory(std::size_t n_values, int repeats);

}  // namespace lacquer::bench
