#include <fmt/format.h>

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "libbrdf/error.h"
#include "tools/json_output.h"
#include "tools/report_page.h"

namespace lacquer::tools {

std::vector<ReportBrdf> load_named_brdfs(const std::vector<std::string>& files) {
  std::vector<ReportBrdf> brdfs;
  for (const auto& file : files) {
    // The name alone where it tells them apart.
    const std::filesystem::path path = file;
    std::string name = path.filename().string();
    for (const auto& other : files)
      if (&other != &file && std::filesystem::path(other).filename() == path.filename()) name = file;
    brdfs.push_back({name, file, brdf::load_brdf(file)});
  }
  return brdfs;
}

void add_report(CLI::App& app, Context& context) {
  struct Options {
    std::vector<std::string> inputs;
    std::string output, probe;
    ReportOptions report;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("report", "one page with pictures and plots of a session or of BRDF files");
  command->add_option("inputs", options->inputs, "a session folder, or BRDF files: table.exr, fit.json, MERL .binary, RGL .bsdf; the first is the reference")->required();
  command->add_option("-o,--output", options->output, "page to write (default: SESSION/report.html, else report.html)");
  command->add_option("--probe", options->probe, "light probe for the spheres, OpenEXR, latitude-longitude (default: the studio that comes with Lacquer)");
  command->add_option("--max-theta-deg", options->report.max_theta_deg, "comparisons leave out light and camera directions beyond this")->capture_default_str()->check(CLI::Range(1.0, 90.0));
  add_json_option(*command, context);
  command->callback([options, &context] {
    options->report.probe = options->probe;
    const bool session = std::filesystem::is_directory(options->inputs.front());
    if (session && options->inputs.size() > 1) throw Error(ErrorCode::usage, fmt::format("{}: expected one session folder alone, or BRDF files", options->inputs.front()));
    const std::filesystem::path output = !options->output.empty() ? std::filesystem::path(options->output)
                                         : session ? std::filesystem::path(options->inputs.front()) / "report.html" : std::filesystem::path("report.html");
    if (session)
      write_session_report(options->inputs.front(), output, options->report);
    else
      write_brdf_report(load_named_brdfs(options->inputs), output, options->report);
    if (context.json) {
      auto j = json_result(context, session ? std::vector<std::string>{} : options->inputs);
      j["report"] = output.string();
      j["bytes"] = std::filesystem::file_size(output);
      return print_json(j);
    }
    if (!context.quiet) fmt::print(stderr, "report: {} ({:.1f} MB)\n", output.string(), static_cast<double>(std::filesystem::file_size(output)) / 1e6);
  });
}

}  // namespace lacquer::tools
