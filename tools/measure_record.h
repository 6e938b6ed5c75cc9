#pragma once

#include <filesystem>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "libcalib/rerender.h"

namespace lacquer::tools {

/// What `lacquer measure` says besides calibration, table and fit: SESSION/measure.json.
struct MeasureRecord {
  std::vector<std::pair<std::string, double>> seconds;  ///< stage, wall time
  std::vector<calib::ViewError> view_errors;            ///< the fit against every photograph
  std::string coverage;                                 ///< samples used and left out, in words
};

nlohmann::ordered_json to_json(const std::vector<calib::ViewError>& errors);

void write_measure_record(const std::filesystem::path& file, const MeasureRecord& record, const std::string& provenance_json);
/// nullopt: there is none. Throws Error{file}.
std::optional<MeasureRecord> read_measure_record(const std::filesystem::path& file);

}  // namespace lacquer::tools
