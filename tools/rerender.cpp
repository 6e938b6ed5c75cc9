#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "libacquire/session.h"
#include "libbrdf/brdf.h"
#include "libcalib/calibration.h"
#include "libcalib/rerender.h"
#include "tools/json_output.h"
#include "tools/measure_record.h"

namespace lacquer::tools {

void add_rerender(CLI::App& app, Context& context) {
  struct Options {
    std::string session, paint, picture;
    calib::RerenderOptions rerender;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("rerender", "render the photographs of a session with a BRDF and state the error of each");
  command->add_option("session", options->session, "session folder with merged radiance images")->required();
  command->add_option("brdf", options->paint, "any BRDF file (default: SESSION/fit.json)");
  command->add_option("--picture", options->picture, "PNG: photograph, re-rendering, difference side by side");
  command->add_option("--n-pictured", options->rerender.n_pictured, "views in the picture")->capture_default_str()->check(CLI::Range(1, 100));
  add_json_option(*command, context);
  command->callback([options, &context] {
    const std::filesystem::path folder = options->session;
    const acquire::Session session = acquire::read_session(folder);
    const calib::Calibration calibration = calib::read_calibration(folder / "calibration.json");
    const auto paint = brdf::load_brdf(options->paint.empty() ? folder / "fit.json" : std::filesystem::path(options->paint));
    auto errors = calib::rerender_session(session, calibration, *paint, options->rerender, options->picture, stderr_progress(context));
    if (context.json) {
      auto j = json_result(context);
      j["views"] = to_json(errors);
      if (!options->picture.empty()) j["picture"] = options->picture;
      return print_json(j);
    }
    fmt::print("view,n_values,relative_rms,mean_abs_log,bias_log\n");
    for (const auto& e : errors) fmt::print("{},{},{:.6f},{:.6f},{:.6f}\n", e.view, e.n_values, e.relative_rms, e.mean_abs_log, e.bias_log);
    if (!context.quiet && !options->picture.empty()) fmt::print(stderr, "picture: {}\n", options->picture);
  });
}

}  // namespace lacquer::tools
