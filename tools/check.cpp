#include <fmt/format.h>

#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>

#include "libbrdf/brdf.h"
#include "libbrdf/error.h"
#include "libbrdf/physical_checks.h"
#include "tools/fit_table.h"
#include "tools/json_output.h"

namespace lacquer::tools {

namespace {

constexpr double degree = std::numbers::pi / 180;

nlohmann::ordered_json to_json(const brdf::Asymmetry& a) {
  return {{"n", a.n}, {"mean_abs_log", a.mean_abs_log}, {"median_abs_log", a.median_abs_log}, {"p95_abs_log", a.p95_abs_log}};
}

nlohmann::ordered_json to_json(const brdf::PhysicalChecks& checks, const std::string& input, const std::string& description, const Context& context) {
  nlohmann::ordered_json j = json_result(context, {input});
  j["description"] = description;
  j["reciprocity"] = to_json(checks.reciprocity);
  j["mirror"] = to_json(checks.mirror);
  j["n_direction_channels"] = checks.n_directions;
  j["n_negative"] = checks.n_negative;
  j["n_zero"] = checks.n_zero;
  j["n_undefined"] = checks.n_undefined;
  j["most_negative"] = checks.most_negative;
  for (const auto& r : checks.reflectances)
    j["reflectance"].push_back({{"theta_i_deg", r.theta_i / degree},
                                {"value", {r.value.x, r.value.y, r.value.z}},
                                {"sigma", {r.sigma.x, r.sigma.y, r.sigma.z}},
                                {"undefined", r.undefined},
                                {"conserves_energy", r.conserves_energy()}});
  return j;
}

std::string to_text(const brdf::PhysicalChecks& checks, double max_theta_deg) {
  const auto asymmetry = [](const brdf::Asymmetry& a) {
    return fmt::format("mean |ln| {:.5f}, median {:.5f}, 95th percentile {:.5f}", a.mean_abs_log, a.median_abs_log, a.p95_abs_log);
  };
  std::string text = fmt::format("directions within {:g} deg of the normal\n", max_theta_deg);
  text += "reciprocity            " + asymmetry(checks.reciprocity) + "\n";
  text += "mirror symmetry        " + asymmetry(checks.mirror) + "\n";
  text += fmt::format("negative values        {} of {} (lowest {:.3g} 1/sr), {} zero, {} undefined\n", checks.n_negative,
                      checks.n_directions - checks.n_undefined, checks.most_negative, checks.n_zero, checks.n_undefined);
  // An integral over the cells of a table has an error; one of a model is exact to the digits shown.
  const auto value = [](double v, double sigma) { return sigma > 1e-5 ? with_error_aligned(v, sigma, 8, 10) : fmt::format("{:8.5f}          ", v); };
  text += "\ntheta_i  directional-hemispherical reflectance R, G, B             undefined\n";
  for (const auto& r : checks.reflectances)
    text += fmt::format("{:3.0f} deg  {} {} {} {:7.2f} %{}\n", r.theta_i / degree, value(r.value.x, r.sigma.x), value(r.value.y, r.sigma.y), value(r.value.z, r.sigma.z),
                        100 * r.undefined, r.conserves_energy() ? "" : "   MORE THAN ALL LIGHT");
  return text;
}

}  // namespace

void add_check(CLI::App& app, Context& context) {
  struct Options {
    std::string input;
    double max_theta_deg = 80;
    brdf::CheckOptions check;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("check", "is a BRDF physically possible? reciprocity, energy, negative values");
  command->add_option("INPUT", options->input, "any BRDF file")->required();
  add_json_option(*command, context);
  command->add_option("--max-theta-deg", options->max_theta_deg, "reciprocity: leave out directions beyond this")->capture_default_str();
  command->add_option("--resolution", options->check.resolution, "steps of theta_h in the reflectance's integral")->capture_default_str();
  command->callback([options, &context] {
    options->check.max_theta = options->max_theta_deg * degree;
    options->check.validate();
    const auto input = brdf::load_brdf(options->input);
    const brdf::PhysicalChecks checks = brdf::check_physics(*input, options->check);
    if (context.json)
      print_json(to_json(checks, options->input, input->description(), context));
    else
      fmt::print("{}\n{}", input->description(), to_text(checks, options->max_theta_deg));
  });
}

}  // namespace lacquer::tools
