#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "libfit/fit.h"

/// What the chain can be run with: one knob at a time is turned away from the base, the quick simulated rig.
namespace lacquer::bench {

struct Setting {
  std::string knob, value;
  double work = 0;  ///< amount of work that the knob stands for, in its own unit: exposures, lights, pixels, cells; 0: none
  std::vector<std::pair<std::string, std::string>> edits;  ///< of the rig file's text, each found exactly once
  fit::FitOptions fit;
  bool capture = true;  ///< false: only table and fit differ, the base's table is used
  int coarse = 1;       ///< the base's table with cells so many times as wide in each direction
};

/// The first is the base. `few`: two per knob.
std::vector<Setting> settings(bool few);

/// Text with the edits. Throws std::logic_error where one does not fit: then rig file and settings have grown apart.
std::string edited(std::string text, const Setting& setting);

}  // namespace lacquer::bench
