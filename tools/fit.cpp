#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <vector>

#include "libbrdf/brdf.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libbrdf/table.h"
#include "libcalib/calibration.h"
#include "libcalib/drift_session.h"
#include "libcalib/geometry_moves.h"
#include "libfit/fit.h"
#include "tools/command.h"
#include "tools/fit_metrics.h"
#include "tools/fit_table.h"
#include "tools/geometry_provenance.h"
#include "tools/session_samples.h"
#include "tools/summary.h"

namespace lacquer::tools {

namespace {

struct Options {
  std::vector<std::string> inputs;
  std::string output, table;
  double max_theta_deg = 85;
  bool samples = false;
  calib::SampleOptions sample_options;
  fit::FitOptions fit;
};

/// What was fitted, for what the fit is judged by afterwards.
struct Fitted {
  fit::FitResult fit;
  std::unique_ptr<brdf::Brdf> input;
  bool absolute_scale = true;
};

/// Fits a table as it is; any other BRDF at the centres of the table's cells. A table of our own is large and read for this fit alone: what is
/// not needed any more is freed on the way.
Fitted fit_file(const std::string& file, fit::FitOptions options, const Progress& progress) {
  if (std::filesystem::path(file).extension() == ".exr") {
    brdf::HalfAngleTable table = brdf::read_table(file);
    options.half_vector_sigma = half_vector_sigma_of(table.provenance_json);
    Fitted fitted{fit::fit_and_free_places(table, options, progress), nullptr, table.absolute_scale};
    fitted.input = std::make_unique<brdf::TableBrdf>(std::move(table), "table " + file);
    return fitted;
  }
  auto input = brdf::load_brdf(file);
  if (const auto* in = dynamic_cast<const brdf::TableBrdf*>(input.get())) {
    options.half_vector_sigma = half_vector_sigma_of(in->table().provenance_json);
    return {fit::fit_table(in->table(), options, progress), std::move(input), in->table().absolute_scale};
  }
  brdf::HalfAngleTable cells = brdf::tabulate_brdf(*input, options.min_cosine);
  return {fit::fit_and_free_places(cells, options, progress), std::move(input), cells.absolute_scale};
}

std::string one_line(const brdf::CookTorrance& model) {
  std::string text;
  for (const auto& lobe : model.lobes)
    text += fmt::format("{}m {:.4g} r {:.3g}", text.empty() ? "" : ", ", lobe.m, lobe.r);
  return text.empty() ? "diffuse only" : text;
}

std::string candidate_table(const fit::FitResult& fit) {
  std::size_t width = 12;
  for (const fit::Candidate& c : fit.candidates) width = std::max(width, c.structure.size());
  std::string text = fmt::format("\n{:<{}} {:>10} {:>10} {:>6} {:>12}\n", "candidate", width, "mean |ln|", "parameters", "ns", "criterion");
  for (const fit::Candidate& c : fit.candidates)
    text += fmt::format("{:<{}} {:>10.4g} {:>10} {:>6.2f} {:>+12.4g}{}\n", c.structure, width, c.mean_abs_log, c.n_parameters, c.evaluation_ns,
                        c.criterion, c.pareto ? "  no faster one is as near" : "");
  if (fit.candidates.size() > 1)
    text += fmt::format("chosen: {}, whose error with {:.3g} per parameter added is least\n        (1 in {:.3g} values counts as independent)\n",
                        fit.candidates.front().structure, fit.parameter_price, fit.overdispersion);
  return text + "\n";
}

std::string metrics_text(const fit::FitMetrics& m) {
  const brdf::BrdfDifference& d = m.difference;
  std::string text = fmt::format("cosine RMS   {:.4g} %   weighted by cosines and solid angles, within 80 deg of the normal\ncube root    {:.4g} sr^(-1/3)   RMS of cube roots\n",
                                 100 * d.cosine_rms, d.cube_root_rms);
  if (d.n_pixels) text += fmt::format("dE2000       {:.3f} mean, {:.3f} 95 %   sphere under point lights\n", d.delta_e_mean, d.delta_e_p95);
  if (m.probe_pixels) text += fmt::format("dE2000       {:.3f} mean, {:.3f} 95 %   sphere under the light probe\n", m.probe_delta_e_mean, m.probe_delta_e_p95);
  return text + fmt::format("dE2000       {:.3f} mean   between the fit and what its standard errors allow\n", m.delta_e_of_errors);
}

/// How much of the parameters' standard errors comes from those of the geometry, of a fit to samples.
std::string calibration_text(const fit::FitResult& fit) {
  double largest = 0;
  const fit::Parameter* of = nullptr;
  for (const fit::Parameter& p : fit.parameters)
    if (p.sigma > 0 && p.calibration_sigma > largest * p.sigma) largest = p.calibration_sigma / p.sigma, of = &p;
  if (!of) return "";
  return fmt::format("geometry     its errors are in the standard errors: up to {:.0f} % of them ({})\n", 100 * largest, of->name);
}

std::string to_text(const std::string& input, const std::string& description, const std::string& output, const fit::FitResult& fit, bool samples) {
  std::string text = fmt::format("input        {} ({})\n\n", input, description);
  text += parameter_table(fit, nullptr);
  text += fmt::format("\nmean |ln|    {:.4g}   ln = natural logarithm of fit / table\nrms ln       {:.4g}\n",
                      fit.mean_abs_log, fit.rms_log);
  if (fit.metrics) text += metrics_text(*fit.metrics);
  text += samples ? calibration_text(fit) : table_geometry_note(fit.options.half_vector_sigma, "SESSION");
  text += fmt::format("chi2/n       {:.4g}{}\n", fit.reduced_chi2,
                      fit.reduced_chi2 > 1 ? "   above 1: standard errors are scaled up by its root" : "");
  if (fit.shared_error > 0)
    text += fmt::format("misfit       {:.2g} %   the model does not follow the paint closer; cells of one direction of light count together\n",
                        100 * fit.shared_error);
  text += fmt::format("energy       {:.3f}   normal-incidence albedo, largest channel{}\n", fit.energy,
                      fit.energy > 1 ? ": IMPLAUSIBLE, more than 1" : "");
  text += fmt::format("{} {} of {} usable\n", samples ? "samples     " : "cells       ", fit.n_cells, fit.n_cells_available);
  const auto& out = fit.left_out;
  text += fmt::format(
      "left out     {} grazing, {} not positive, {} not finite, {} not measured (cells times channels)\n",
      out.grazing, out.not_positive, out.not_finite, out.not_measured);
  if (fit.n_bounds > 0) text += fmt::format("bounds       {} clipped (cells times channels): the model is to be at least that\n", fit.n_bounds);
  for (std::size_t i = 0; i < fit.minima.size(); ++i)
    text += fmt::format("minimum {}    cost {:.6g}: {}\n", i + 1, fit.minima[i].cost, one_line(fit.minima[i].model));
  text += candidate_table(fit);
  text += fmt::format("solver       {}{}\n", fit.converged ? "" : "DID NOT CONVERGE: ", fit.message);
  text += fmt::format("time         {:.2f} s\n", fit.seconds);
  if (!output.empty()) text += fmt::format("fit          {}\n", output);
  return text;
}

/// Where the fit of `input` goes: the file itself, or one of its name in the folder where there are several inputs.
std::string output_of(const Options& options, const std::string& input) {
  if (options.output.empty() || options.inputs.size() == 1) return options.output;
  return (std::filesystem::path(options.output) / (std::filesystem::path(input).stem().string() + ".json")).string();
}

/// Refits to the samples of the session whose table `fit` is of.
void refit_to_samples(const Options& options, const std::filesystem::path& folder, bool absolute_scale, const Context& context, fit::FitResult& fit) {
  const auto session = std::make_shared<const acquire::Session>(acquire::read_session(folder));
  const calib::Calibration calibration = calib::read_calibration(folder / "calibration.json");
  const auto source = [&](const calib::Calibration& c) { return session_samples(session, c, options.sample_options); };
  std::vector<fit::SampleSource> perturbed;
  if (const auto moved = calib::moved_calibrations(*session, calibration))
    for (const calib::Calibration& c : *moved) perturbed.push_back(source(c));
  // Distances of the lights are among what is moved.
  fit.scale_sigma = std::hypot(calib::drift_scale_sigma(*session, calibration), calibration.scale_sigma);
  fit = fit::fit_samples(source(calibration), fit, absolute_scale, perturbed, stderr_progress(context));
}

/// Fits one input and reports on it.
NamedFit fit_one(const Options& options, const std::string& given, const Context& context) {
  const std::string name = options.samples ? (std::filesystem::path(given) / "table.exr").string() : given;
  Fitted fitted = fit_file(name, options.fit, stderr_progress(context));
  NamedFit named{std::filesystem::path(name).stem().string(), std::move(fitted.fit)};
  if (options.samples) {
    named.name = std::filesystem::path(given).filename().string();
    refit_to_samples(options, given, fitted.absolute_scale, context, named.fit);
  }
  fit::add_evaluation_costs(named.fit);
  add_metrics(*fitted.input, named.fit);
  const std::string provenance = provenance_json(context, {name}), output = output_of(options, name);
  if (!output.empty()) fit::write_fit(output, named.fit, fitted.absolute_scale, provenance);
  if (context.json)
    fmt::print("{}", fit::fit_to_json(named.fit, fitted.absolute_scale, provenance));
  else
    fmt::print("{}", to_text(given, fitted.input->description(), output, named.fit, options.samples));
  return named;
}

/// Complaints about the command line before an hour of work, not after it.
void check(const Options& options) {
  options.fit.validate();
  if (!options.table.empty()) table_format(options.table);
  if (options.inputs.size() > 1 && !options.output.empty() && !std::filesystem::is_directory(options.output))
    throw Error(ErrorCode::usage, fmt::format("-o: expected an existing folder for the fits of {} inputs, got {}", options.inputs.size(), options.output));
}

}  // namespace

void add_fit(CLI::App& app, Context& context) {
  auto options = std::make_shared<Options>();
  fit::FitOptions& o = options->fit;
  CLI::App* command =
      app.add_subcommand("fit", "table -> multi-lobe Cook-Torrance parameters with standard errors");
  command->add_option("TABLE", options->inputs, "table.exr, MERL .binary, RGL .bsdf or a model; several: one fit each")->required();
  command->add_option("-o,--output", options->output, "fit.json to write; several inputs: folder for NAME.json");
  command->add_option("--table", options->table, "parameters of all inputs as .csv, .md or .tex, in their order");
  command->add_flag("--samples", options->samples,
                    "TABLE is a session folder: refit the structure found in its table.exr to the samples of its images themselves");
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
  command->add_flag("--profile", o.profile, "profile intervals of all parameters; takes minutes on a full table");
  command->add_option_function<std::string>("--solver", [&o](const std::string& name) { o.ceres = name == "ceres"; },
                                            "own, or ceres to check one by the other")
      ->check(CLI::IsMember({"own", "ceres"}));
  command->add_option("--threads", o.threads, "0: all; the result does not depend on it")
      ->capture_default_str();
  add_json_option(*command, context);
  command->callback([options, &context] {
    options->sample_options.min_cosine = options->fit.min_cosine = cosine_of_degrees("--max-theta-deg", options->max_theta_deg);
    check(*options);
    std::vector<NamedFit> fits;
    const bool list = context.json && options->inputs.size() > 1;  // an object each
    for (const std::string& input : options->inputs) {
      if (!context.json && !fits.empty()) fmt::print("\n");
      if (list) fmt::print("{}", fits.empty() ? "[\n" : ",\n");
      fits.push_back(fit_one(*options, input, context));
    }
    if (list) fmt::print("]\n");
    if (!options->table.empty()) brdf::write_text_atomically(options->table, fit_table_text(fits, table_format(options->table)));
  });
}

}  // namespace lacquer::tools
