#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "libbrdf/metrics.h"
#include "libcalib/samples.h"
#include "tools/command.h"

/// What --json prints. Every object begins alike; numbers are in radians, metres, seconds, 1/sr; what is not a number is null.
namespace lacquer::tools {

/// {"version": 1, "software", "command", "inputs": {file: checksum}}.
nlohmann::ordered_json json_result(const Context& context, const std::vector<std::string>& inputs = {});

/// On stdout, indented; bytes of file names that are not UTF-8 are replaced.
void print_json(const nlohmann::ordered_json& j);

nlohmann::ordered_json to_json(const brdf::BrdfDifference& difference);

/// Samples used and left out, cells of each origin in the middle channel.
nlohmann::ordered_json to_json(const calib::Tabulation& tabulation);

}  // namespace lacquer::tools
