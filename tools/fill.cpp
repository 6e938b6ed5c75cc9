#include <fmt/format.h>

#include <memory>
#include <nlohmann/json.hpp>

#include "libbrdf/brdf.h"
#include "libbrdf/files.h"
#include "libbrdf/fill_table.h"
#include "tools/json_output.h"
#include "tools/summary.h"

namespace lacquer::tools {

namespace {

nlohmann::ordered_json to_json(const brdf::FillReport& r) {
  return {{"data", r.n_data},         {"symmetric", r.n_symmetric}, {"filled", r.n_filled}, {"modelled", r.n_modelled},
          {"left", r.n_left},         {"length_scale", r.length_scale}, {"trial_mean_abs_log", r.trial_mean_abs_log},
          {"trial_sigma_factor", r.trial_sigma_factor}};
}

}  // namespace

void add_fill(CLI::App& app, Context& context) {
  struct Options {
    std::string table, output, model;
    double max_theta_deg = 88;
    brdf::FillOptions fill;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("fill", "fill the holes of a table, each cell flagged and with a variance");
  command->add_option("TABLE", options->table, "table.exr")->required();
  command->add_option("-o,--output", options->output, "table to write")->required();
  command->add_option("--model", options->model, "fit.json: for cells that cannot be interpolated, flagged modelled");
  command->add_option("--max-sigma", options->fill.max_sigma, "interpolate where the logarithm is better known than this")->capture_default_str();
  command->add_option("--max-theta-deg", options->max_theta_deg, "leave alone what is nearer to the horizon")->capture_default_str();
  add_json_option(*command, context);
  command->callback([options, &context] {
    options->fill.min_cosine = cosine_of_degrees("--max-theta-deg", options->max_theta_deg);
    options->fill.validate();
    brdf::HalfAngleTable table = brdf::read_table(options->table);
    std::unique_ptr<brdf::Brdf> model;
    std::vector<std::string> inputs{options->table};
    if (!options->model.empty()) {
      model = brdf::load_brdf(options->model);
      options->fill.model = model.get();
      inputs.push_back(options->model);
    }
    const auto reports = brdf::fill_holes(table, options->fill, stderr_progress(context));
    auto provenance = nlohmann::ordered_json::parse(provenance_json(context, inputs));
    provenance["table"] = nlohmann::ordered_json::parse(table.provenance_json, nullptr, false);
    for (const auto& r : reports) provenance["filling"].push_back(to_json(r));
    table.provenance_json = provenance.dump();
    brdf::write_table(options->output, table);
    if (context.json) {
      auto j = json_result(context, inputs);
      j["channels"] = provenance["filling"];
      j["table"] = options->output;
      return print_json(j);
    }
    fmt::print("cells of   measured     filled   mirrored   modelled       left   mean |ln| of trial\n");
    for (std::size_t c = 0; c < reports.size(); ++c) {
      const auto& r = reports[c];
      fmt::print("{:<8} {:>10} {:>10} {:>10} {:>10} {:>10} {:>20.4f}\n", reports.size() == 3 ? "RGB"[c] : 'Y', r.n_data, r.n_filled, r.n_symmetric, r.n_modelled, r.n_left, r.trial_mean_abs_log);
    }
    fmt::print("trial: known cells, predicted through gaps like those that were filled\ntable: {}\n", options->output);
  });
}

}  // namespace lacquer::tools
