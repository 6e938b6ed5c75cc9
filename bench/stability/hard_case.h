#pragma once

#include <fmt/format.h>

#include <string>
#include <vector>

namespace lacquer::bench {

/// What one hard case did. `holds`: as documented; else the table says so and the program fails.
struct HardCase {
  std::string what, happens, figure;
  bool holds = true;
};
using HardCases = std::vector<HardCase>;

/// A figure that is to stay at or below a limit; not a number never does.
inline HardCase at_most(std::string what, std::string happens, double figure, double limit, const std::string& unit = "") {
  return {std::move(what), std::move(happens), fmt::format("{:.2g}{} (at most {:g})", figure, unit, limit), figure <= limit};
}

// One function per stage. Everything is seeded, so a table is the same wherever the floating-point arithmetic is.
HardCases response_cases();
HardCases merge_cases();
HardCases geometry_cases();
HardCases table_cases();
HardCases filling_cases();
HardCases fit_cases();
HardCases format_cases();
HardCases evaluation_cases();

}  // namespace lacquer::bench
