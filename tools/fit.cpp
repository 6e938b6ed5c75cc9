#include <fmt/format.h>

#include <memory>
#include <optional>

#include "libbrdf/brdf.h"
#include "libbrdf/table.h"
#include "libfit/fit.h"
#include "tools/command.h"
#include "tools/summary.h"

namespace lacquer::tools {

namespace {

struct Options {
  std::string input, output;
  double max_theta_deg = 85;
  bool json = false;
  fit::FitOptions fit;
};

/// A table as it is, without a copy (it is large); any other BRDF at the centres of the table's cells, put into `storage`.
const brdf::HalfAngleTable& table_of(const brdf::Brdf& input, double min_cosine, std::optional<brdf::HalfAngleTable>& storage) {
  if (const auto* table = dynamic_cast<const brdf::TableBrdf*>(&input)) return table->table();
  return storage.emplace(brdf::tabulate_brdf(input, min_cosine));
}

std::string one_line(const brdf::CookTorrance& model) {
  std::string text;
  for (const auto& lobe : model.lobes)
    text += fmt::format("{}m {:.4g} r {:.3g}", text.empty() ? "" : ", ", lobe.m, lobe.r);
  return text.empty() ? "diffuse only" : text;
}

std::string candidate_table(const fit::FitResult& fit) {
  std::string text = fmt::format("\n{:<36} {:>10} {:>10} {:>6} {:>12}\n", "candidate", "mean |ln|", "parameters", "ns", "criterion");
  for (const fit::Candidate& c : fit.candidates)
    text += fmt::format("{:<36} {:>10.4g} {:>10} {:>6.2f} {:>+12.4g}\n", c.structure, c.mean_abs_log, c.n_parameters, c.evaluation_ns,
                        c.criterion);
  return text + "\n";
}

std::string to_text(const Options& options, const brdf::Brdf& input, const fit::FitResult& fit) {
  std::string text = fmt::format("input        {} ({})\n\n", options.input, input.description());
  text += parameter_table(fit, nullptr);
  text += fmt::format("\nmean |ln|    {:.4g}   ln = natural logarithm of fit / table\nrms ln       {:.4g}\n",
                      fit.mean_abs_log, fit.rms_log);
  text += fmt::format("chi2/n       {:.4g}{}\n", fit.reduced_chi2,
                      fit.reduced_chi2 > 1 ? "   above 1: standard errors are scaled up by its root" : "");
  if (fit.shared_error > 0)
    text += fmt::format("misfit       {:.2g} %   the model does not follow the paint closer; cells of one direction of light count together\n",
                        100 * fit.shared_error);
  text += fmt::format("energy       {:.3f}   normal-incidence albedo, largest channel{}\n", fit.energy,
                      fit.energy > 1 ? ": IMPLAUSIBLE, more than 1" : "");
  text += fmt::format("cells        {} of {} usable\n", fit.n_cells, fit.n_cells_available);
  const auto& out = fit.left_out;
  text += fmt::format(
      "left out     {} grazing, {} not positive, {} not finite, {} not measured (cells times channels)\n",
      out.grazing, out.not_positive, out.not_finite, out.not_measured);
  for (std::size_t i = 0; i < fit.minima.size(); ++i)
    text += fmt::format("minimum {}    cost {:.6g}: {}\n", i + 1, fit.minima[i].cost, one_line(fit.minima[i].model));
  text += candidate_table(fit);
  text += fmt::format("solver       {}{}\n", fit.converged ? "" : "DID NOT CONVERGE: ", fit.message);
  text += fmt::format("time         {:.2f} s\n", fit.seconds);
  if (!options.output.empty()) text += fmt::format("fit          {}\n", options.output);
  return text;
}

}  // namespace

void add_fit(CLI::App& app, Context& context) {
  auto options = std::make_shared<Options>();
  fit::FitOptions& o = options->fit;
  CLI::App* command =
      app.add_subcommand("fit", "table -> multi-lobe Cook-Torrance parameters with standard errors");
  command->add_option("TABLE", options->input, "table.exr, MERL .binary, RGL .bsdf or a model")->required();
  command->add_option("-o,--output", options->output, "fit.json to write");
  command->add_option("--lobes", o.n_lobes, "number of lobes, 0 to 5; not given: the structure that the data supports");
  command->add_option("--max-cells", o.max_cells, "cells used, spread over the table")->capture_default_str();
  command->add_option("--starts", o.n_starts, "starts that are refined")->capture_default_str();
  command
      ->add_option("--model-sigma", o.model_sigma,
                   "relative error of model and cell average, beside the table's variance")
      ->capture_default_str();
  command
      ->add_option("--max-theta-deg", options->max_theta_deg,
                   "leave out light and camera directions beyond this")
      ->capture_default_str();
  command->add_option("--threads", o.threads, "0: all; the result does not depend on it")
      ->capture_default_str();
  command->add_flag("--json", options->json, "the fit as JSON instead of lines for people");
  command->callback([options, &context] {
    options->fit.min_cosine = cosine_of_degrees("--max-theta-deg", options->max_theta_deg);
    options->fit.validate();
    const auto input = brdf::load_brdf(options->input);
    std::optional<brdf::HalfAngleTable> storage;
    const brdf::HalfAngleTable& table = table_of(*input, options->fit.min_cosine, storage);
    fit::FitResult fit = fit::fit_table(table, options->fit, stderr_progress(context));
    fit::add_evaluation_costs(fit);
    const std::string provenance = provenance_json(context, {options->input});
    if (!options->output.empty()) fit::write_fit(options->output, fit, table.absolute_scale, provenance);
    if (options->json)
      fmt::print("{}", fit::fit_to_json(fit, table.absolute_scale, provenance));
    else
      fmt::print("{}", to_text(*options, *input, fit));
  });
}

}  // namespace lacquer::tools
