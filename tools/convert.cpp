#include <fmt/format.h>

#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>

#include "libbrdf/brdf.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libbrdf/metrics.h"
#include "libbrdf/relative_error.h"
#include "tools/json_output.h"
#include "tools/convert_targets.h"
#include "tools/summary.h"

namespace lacquer::tools {

namespace {

constexpr double max_theta_deg = 75;

struct Options {
  std::string input, output, format;
  ConvertOptions convert;
};

/// What the output lost against the input, measured on the file as read back or on the target's published formula.
struct Loss {
  brdf::RelativeError everywhere, near_specular;
  brdf::BrdfDifference difference;
};

Loss measure_loss(const brdf::Brdf& source, const brdf::Brdf& result) {
  const double max_theta = max_theta_deg * std::numbers::pi / 180;
  brdf::CompareOptions options;
  options.max_theta = max_theta;
  return {brdf::relative_error(source, result, max_theta), brdf::relative_error_near_specular(source, result, max_theta),
          brdf::compare(source, result, options)};
}

std::string error_line(const char* name, const brdf::RelativeError& e) {
  std::string line = fmt::format("{:<22} {:.3f} % mean, {:.2f} % largest", name, 100 * e.mean, 100 * e.max);
  if (e.n_lost) line += fmt::format("; {} of {} values lost", e.n_lost, e.n + e.n_lost);
  return line + "\n";
}

std::string to_text(const Options& options, const Converted& converted, const Loss& loss) {
  std::string text = fmt::format("{:<22} {} ({:.1f} kB)\n", "written", options.output,
                                 static_cast<double>(std::filesystem::file_size(options.output)) / 1e3);
  text += fmt::format("{:<22} {}\n", "format", converted.format);
  for (const auto& note : converted.notes) text += fmt::format("{:<22} {}\n", "note", note);
  text += fmt::format("loss: {},\n      light and camera within {:g} deg of the normal\n", converted.judged_by, max_theta_deg);
  text += error_line("relative error", loss.everywhere) + error_line("near mirror direction", loss.near_specular);
  return text + difference_text(loss.difference);
}

nlohmann::ordered_json to_json(const brdf::RelativeError& e) {
  return {{"mean", e.mean}, {"max", e.max}, {"n", e.n}, {"n_lost", e.n_lost}};
}

nlohmann::ordered_json result_json(const Options& options, const Context& context, const Converted& converted, const Loss& loss) {
  nlohmann::ordered_json j = json_result(context, {options.input});
  j["output"] = options.output;
  j["bytes"] = std::filesystem::file_size(options.output);
  j["format"] = converted.format;
  j["notes"] = converted.notes;
  j["judged_by"] = converted.judged_by;
  j["max_theta_deg"] = max_theta_deg;
  j["relative_error"] = to_json(loss.everywhere);
  j["relative_error_near_specular"] = to_json(loss.near_specular);
  j["metrics"] = tools::to_json(loss.difference);
  return j;
}

void run(Options options, const Context& context) {
  options.convert.provenance = provenance_json(context, {options.input});
  const ConvertTarget& target = options.format.empty() ? target_of_file(options.output) : target_named(options.format);
  std::error_code missing;
  if (std::filesystem::equivalent(options.input, options.output, missing))
    throw Error(ErrorCode::usage, options.output + ": is the input; choose another name for the output");
  const auto source = brdf::load_brdf(options.input);
  const Converted converted = target.write(options.output, *source, options.convert);
  const Loss loss = measure_loss(*source, *converted.result);
  if (context.json)
    print_json(result_json(options, context, converted, loss));
  else
    fmt::print("{}", to_text(options, converted, loss));
}

}  // namespace

void add_convert(CLI::App& app, Context& context) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("convert", "any BRDF file -> another format, and what that loses");
  command->add_option("INPUT", options->input, "any BRDF file that compare reads; renderers' materials need a fit.json or paint")->required();
  command->add_option("-o,--output", options->output, "file to write; its extension chooses the format")->required();
  command->add_option("--format", options->format, fmt::format("overrides the extension: {}", target_names()));
  command->add_flag("--sigma", options->convert.sigma, "npy: also write the standard errors, NAME.sigma.npy");
  command->add_option("--theta-i", options->convert.rgl.n_theta_i, "bsdf: incident angles")->capture_default_str();
  command->add_option("--resolution", options->convert.rgl.resolution, "bsdf: nodes of each side of the square of values")->capture_default_str();
  add_json_option(*command, context);
  command->callback([options, &context] { run(*options, context); });
}

}  // namespace lacquer::tools
