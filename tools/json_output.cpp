#include "tools/json_output.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

namespace lacquer::tools {

using Json = nlohmann::ordered_json;

Json json_result(const Context& context, const std::vector<std::string>& inputs) {
  Json j{{"version", 1}};
  j.update(Json::parse(provenance_json(context, inputs)));
  return j;
}

void print_json(const Json& j) { fmt::print("{}\n", j.dump(2, ' ', false, Json::error_handler_t::replace)); }

Json to_json(const brdf::BrdfDifference& d) {
  const auto or_null = [&](double x) { return d.n_pixels ? Json(x) : Json(); };
  return {{"mean_abs_log", d.mean_abs_log}, {"rms_log", d.rms_log}, {"bias_log", d.bias_log}, {"max_abs_log", d.max_abs_log}, {"cosine_rms", d.cosine_rms}, {"cube_root_rms", d.cube_root_rms},
          {"delta_e_2000_mean", or_null(d.delta_e_mean)}, {"delta_e_2000_p95", or_null(d.delta_e_p95)}, {"scale", d.scale}, {"n_directions", d.n_directions},
          {"n_undefined", d.n_undefined}, {"n_nonpositive", d.n_nonpositive}, {"n_pixels", d.n_pixels}};
}

Json to_json(const calib::Tabulation& t) {
  const auto& n = t.counts;
  const auto& channel = t.table.channels[t.table.channels.size() / 2];
  std::size_t reachable = 0, measured = 0, symmetric = 0, clipped = 0;
  for (std::size_t i = 0; i < brdf::TableGrid::n_cells; ++i) {
    reachable += brdf::TableGrid::reachable(brdf::TableGrid::cell(i));
    measured += channel.origin[i] == brdf::CellOrigin::measured;
    symmetric += channel.origin[i] == brdf::CellOrigin::symmetric;
    clipped += channel.origin[i] == brdf::CellOrigin::clipped;
  }
  return {{"samples", {{"used", n.used}, {"clipped", n.clipped}, {"invalid", n.invalid}, {"masked", n.masked}, {"grazing", n.grazing}, {"blurred", n.blurred}}},
          {"cells", {{"reachable", reachable}, {"measured", measured}, {"symmetric", symmetric}, {"clipped", clipped}}},
          {"absolute_scale", t.table.absolute_scale}, {"scale_sigma", t.table.scale_sigma}};
}

}  // namespace lacquer::tools
