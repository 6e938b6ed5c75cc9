#include <fmt/format.h>

#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>

#include "libbrdf/brdf.h"
#include "libbrdf/error.h"
#include "libbrdf/metrics.h"
#include "tools/json_output.h"
#include "tools/fit_metrics.h"
#include "tools/report_page.h"
#include "tools/summary.h"

namespace lacquer::tools {

namespace {

struct Options {
  std::vector<std::string> files;  ///< the first is the reference
  std::string page;
  double max_theta_deg = 80;
  brdf::CompareOptions compare;
};

struct Compared {
  std::string file;
  std::shared_ptr<const brdf::Brdf> brdf;
  brdf::BrdfDifference difference;  ///< from the reference
  ProbeDifference probe;
};

/// {"version": 1, "software", "command", "inputs", "a", "b", "max_theta_deg", "metrics"}; with more than two files also "others": [{"file",
/// "description", "metrics"}] of the third and following.
nlohmann::ordered_json result_json(const Options& options, const Context& context, const brdf::Brdf& a, const std::vector<Compared>& others) {
  nlohmann::ordered_json j = json_result(context, options.files);
  const auto entry = [](const std::string& file, const brdf::Brdf& brdf) { return nlohmann::ordered_json{{"file", file}, {"description", brdf.description()}}; };
  j["a"] = entry(options.files[0], a);
  j["b"] = entry(others[0].file, *others[0].brdf);
  j["max_theta_deg"] = options.max_theta_deg;
  const auto metrics = [](const Compared& c) {
    nlohmann::ordered_json m = to_json(c.difference);
    m["probe_delta_e_2000_mean"] = c.probe.n ? nlohmann::ordered_json(c.probe.mean) : nlohmann::ordered_json();
    m["probe_delta_e_2000_p95"] = c.probe.n ? nlohmann::ordered_json(c.probe.p95) : nlohmann::ordered_json();
    return m;
  };
  j["metrics"] = metrics(others[0]);
  for (std::size_t i = 1; i < others.size(); ++i) {
    j["others"].push_back(entry(others[i].file, *others[i].brdf));
    j["others"].back()["metrics"] = metrics(others[i]);
  }
  return j;
}

/// File and kind, the file's name once.
std::string name_of(const std::string& file, const brdf::Brdf& brdf) {
  const std::string description = brdf.description();
  return description.find(file) == std::string::npos ? file + ": " + description : description;
}

std::string to_text(const Options& options, const brdf::Brdf& a, const std::vector<Compared>& others) {
  std::string text = "A                      " + name_of(options.files[0], a) + "\n";
  for (std::size_t i = 0; i < others.size(); ++i) text += fmt::format("{:<23}{}\n", std::string(1, static_cast<char>('B' + i)), name_of(others[i].file, *others[i].brdf));
  text += fmt::format("light and camera       within {:g} deg of the normal\n", options.max_theta_deg);
  for (std::size_t i = 0; i < others.size(); ++i) {
    const auto& d = others[i].difference;
    if (others.size() > 1) text += fmt::format("\n{} against A\n", static_cast<char>('B' + i));
    text += difference_text(d) + to_text(others[i].probe);
    if (d.n_nonpositive) text += fmt::format("values <= 0            {} channel values left out of the ln ratios\n", d.n_nonpositive);
    if (d.n_pixels == 0) text += "no pixel of the lit sphere is defined in both: dE2000 means nothing\n";
  }
  return text;
}

}  // namespace

void add_compare(CLI::App& app, Context& context) {
  auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("compare", "difference between BRDF files: log ratio, RMS, dE2000");
  command->add_option("files", options->files, "A B [C...]: the reference and the BRDFs to judge: table.exr, fit.json, MERL .binary or RGL .bsdf")->required()->expected(2, 20);
  command->add_option("--page", options->page, "HTML page with plots, dE maps and lit spheres of all of them, as lacquer report");
  add_json_option(*command, context);
  command->add_flag("--scale", options->compare.scale,
                    "first scale B so that the mean ln ratio is 0 (relative measurements)");
  command
      ->add_option("--max-theta-deg", options->max_theta_deg,
                   "leave out light and camera directions beyond this")
      ->capture_default_str();
  command->callback([options, &context] {
    if (!(options->max_theta_deg > 0 && options->max_theta_deg <= 90))
      throw Error(ErrorCode::usage,
                  fmt::format("--max-theta-deg: expected an angle above 0 and at most 90, got {}",
                              options->max_theta_deg));
    options->compare.max_theta = options->max_theta_deg * std::numbers::pi / 180;
    const auto a = brdf::load_brdf(options->files[0]);
    std::vector<Compared> others;
    for (std::size_t i = 1; i < options->files.size(); ++i) {
      std::shared_ptr<const brdf::Brdf> b = brdf::load_brdf(options->files[i]);
      const brdf::BrdfDifference difference = brdf::compare(*a, *b, options->compare);
      others.push_back({options->files[i], b, difference, probe_difference(*a, *b, difference.scale)});
    }
    if (context.json)
      print_json(result_json(*options, context, *a, others));
    else
      fmt::print("{}", to_text(*options, *a, others));
    if (!options->page.empty()) write_brdf_report(load_named_brdfs(options->files), options->page, {.probe = {}, .max_theta_deg = options->max_theta_deg});
  });
}

}  // namespace lacquer::tools
