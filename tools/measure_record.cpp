#include "tools/measure_record.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::tools {

using Json = nlohmann::ordered_json;

Json to_json(const std::vector<calib::ViewError>& errors) {
  Json list = Json::array();
  for (const auto& e : errors)
    list.push_back({{"view", e.view}, {"n_values", e.n_values}, {"relative_rms", e.relative_rms}, {"mean_abs_log", e.mean_abs_log}, {"bias_log", e.bias_log}});
  return list;
}

void write_measure_record(const std::filesystem::path& file, const MeasureRecord& record, const std::string& provenance_json) {
  Json j{{"version", 1}, {"coverage", record.coverage}};
  j["seconds"] = Json::array();
  for (const auto& [stage, seconds] : record.seconds) j["seconds"].push_back({{"stage", stage}, {"seconds", seconds}});
  j["view_errors"] = to_json(record.view_errors);
  j["provenance"] = Json::parse(provenance_json);
  brdf::write_text_atomically(file, j.dump(1) + "\n");
}

std::optional<MeasureRecord> read_measure_record(const std::filesystem::path& file) {
  if (!std::filesystem::exists(file)) return std::nullopt;
  try {
    const Json j = Json::parse(brdf::read_text(file));
    MeasureRecord record;
    record.coverage = j.at("coverage").get<std::string>();
    for (const auto& s : j.at("seconds")) record.seconds.emplace_back(s.at("stage").get<std::string>(), s.at("seconds").get<double>());
    for (const auto& e : j.at("view_errors"))
      record.view_errors.push_back({e.at("view").get<std::string>(), e.at("n_values").get<std::size_t>(), e.at("relative_rms").get<double>(),
                                    e.at("mean_abs_log").get<double>(), e.at("bias_log").get<double>()});
    return record;
  } catch (const nlohmann::json::exception& e) {
    throw Error(ErrorCode::file, fmt::format("{}: expected what lacquer measure writes: {}", file.string(), e.what()));
  }
}

}  // namespace lacquer::tools
