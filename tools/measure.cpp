#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "libacquire/rig_description.h"
#include "libbrdf/brdf.h"
#include "libbrdf/error.h"
#include "libbrdf/metrics.h"
#include "tools/calibrate_geometry.h"
#include "tools/capture_guard.h"
#include "tools/drift_report.h"
#include "tools/dry_run.h"
#include "tools/geometry_provenance.h"
#include "tools/json_output.h"
#include "tools/measure_chain.h"
#include "tools/measure_record.h"
#include "tools/report_page.h"
#include "tools/summary.h"

namespace lacquer::tools {

namespace {

struct Options {
  std::string rig, paint, data, session;
  double max_theta_deg = 85;
  bool dry_run = false, no_checks = false, no_report = false;
  MeasureOptions measure;
};

/// Median and worst error of the re-rendered photographs.
std::string rerender_text(std::vector<calib::ViewError> errors) {
  if (errors.empty()) return "";
  std::sort(errors.begin(), errors.end(), [](const auto& a, const auto& b) { return a.relative_rms < b.relative_rms; });
  return fmt::format("photographs re-rendered from the fit: relative RMS {:.2f} % median, {:.2f} % worst ({})",
                     100 * errors[errors.size() / 2].relative_rms, 100 * errors.back().relative_rms, errors.back().view);
}

std::string stage_text(const Measurement& m) {
  std::string text = fmt::format("{} views, {} frames.", m.n_views, m.n_frames);
  double total = 0;
  for (const auto& [stage, seconds] : m.seconds) {
    text += fmt::format(" {} {:.2f} s,", stage, seconds);
    if (!stage.starts_with("of this")) total += seconds;
  }
  return text + fmt::format(" total {:.2f} s", total);
}

/// Everything but the comparison with the truth.
void print_text(const Measurement& m, const brdf::CookTorrance* truth) {
  fmt::print("{}\n{}\n\n", coverage_text(m.tabulation), light_and_dark_text(m.calibration));
  if (m.geometry) print_geometry(*m.geometry, m.session);
  fmt::print("{}{}\n", parameter_table(m.fit, truth), table_geometry_note(m.fit.options.half_vector_sigma, m.session.folder.string()));
  fmt::print("scale: {}\n", m.tabulation.table.absolute_scale ? "absolute, 1/sr" : "relative (no reference of known reflectance)");
  if (const double sigma = m.tabulation.table.scale_sigma; sigma > 0)
    fmt::print("known to {:.2g} %, from how steady the lights were and how far away they stand; this is in the errors of kd and ks, which share it\n", 100 * sigma);
  fmt::print("fit to the table: mean |ln(fit/table)| {:.5f} over {} cells, chi2/n {:.2f}{}\n", m.fit.mean_abs_log, m.fit.n_cells, m.fit.reduced_chi2,
             m.fit.converged ? "" : emphasised("; the solver did NOT converge: " + m.fit.message, Emphasis::warning, stdout));
  fmt::print("{}\n", rerender_text(m.view_errors));
}

nlohmann::ordered_json result_json(const Measurement& m, nlohmann::ordered_json j) {
  j.update({{"views", m.n_views}, {"frames", m.n_frames}, {"seconds", nlohmann::ordered_json::object()}});
  for (const auto& [stage, seconds] : m.seconds) j["seconds"][stage] = seconds;
  j["coverage"] = to_json(m.tabulation);
  j["lights_and_darks"] = light_and_dark_text(m.calibration);
  if (m.geometry) j["geometry"] = geometry_json(*m.geometry, m.session);
  if (m.session.rig.adaptive_loss) j["adaptive_bracket"] = bracket_json(m.session);
  j["fit"] = nlohmann::ordered_json::parse(fit::fit_to_json(m.fit, m.tabulation.table.absolute_scale, "{}"));
  j["photographs"] = to_json(m.view_errors);
  return j;
}

void run(const Options& options, const Context& context) {
  const std::filesystem::path folder = options.session;
  acquire::RigDescription rig = acquire::read_rig(options.rig, options.data);
  const bool simulated = rig.kind == acquire::RigDescription::Kind::simulated;
  MeasureOptions measure_options = options.measure;
  measure_options.samples.min_cosine = cosine_of_degrees("--max-theta-deg", options.max_theta_deg);
  if (options.dry_run) return print_dry_run(rig, {.session = folder, .map = {}, .samples = measure_options.samples}, context);
  if (folder.empty()) throw Error(ErrorCode::usage, "-o: missing; expected the folder of the session");
  std::shared_ptr<const brdf::Brdf> paint;
  if (!simulated && !options.paint.empty()) throw Error(ErrorCode::usage, "--paint: only a simulated rig can be given a paint");
  if (!options.paint.empty()) rig.simulation.paint = std::filesystem::absolute(options.paint);
  if (simulated) paint = brdf::load_brdf(rig.simulation.paint);

  measure_options.command_line = context.command_line;
  measure_options.provenance_json = provenance_json(context, {options.rig});
  CaptureGuard guard(rig, !options.no_checks, context);
  measure_options.before_frames = guard.before_frames();
  Measurement m;
  guard.run([&] { m = measure(rig, paint, folder, measure_options, stderr_progress(context)); });

  // The truth enters here, for the final comparison, and nowhere before.
  const auto* truth = dynamic_cast<const brdf::CookTorranceBrdf*>(paint.get());
  std::optional<brdf::BrdfDifference> against_truth;
  if (paint) {
    brdf::CompareOptions compare_options;
    compare_options.scale = !m.tabulation.table.absolute_scale;
    against_truth = brdf::compare(*paint, brdf::CookTorranceBrdf(m.fit.model), compare_options);
  }
  if (!context.json) {
    print_text(m, truth ? &truth->model() : nullptr);
    if (against_truth) fmt::print("\nfit against the truth ({}):\n{}", paint->description(), difference_text(*against_truth));
    fmt::print("\n{}{}\nsession: {}\n", bracket_text(m.session), stage_text(m), folder.string());
    std::fflush(stdout);
  }
  write_measure_record(folder / "measure.json", {m.seconds, m.view_errors, coverage_text(m.tabulation)}, measure_options.provenance_json);
  if (!options.no_report) write_session_report(folder, folder / "report.html", {});
  const bool drift = plot_drift(m.calibration, folder / "drift.svg");
  if (context.json) {
    auto j = result_json(m, json_result(context, {options.rig}));
    if (against_truth) j["against_truth"] = to_json(*against_truth);
    j["session"] = folder.string();
    if (!options.no_report) j["report"] = (folder / "report.html").string();
    return print_json(j);
  }
  if (!options.no_report) fmt::print("report: {}\n", (folder / "report.html").string());
  if (drift) fmt::print("drift of the lights: {}\n", (folder / "drift.svg").string());
}

}  // namespace

void add_measure(CLI::App& app, Context& context) {
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("measure", "the whole chain: capture, merge, tabulate, fit, report");
  command->add_option("rig", options->rig, "rig description (TOML)")->required();
  command->add_option("-o,--output", options->session, "session folder to create");
  command->add_option("--paint", options->paint, "BRDF file that a simulated rig photographs (default: the rig file's)");
  command->add_option("--data", options->data, "folder of a replay rig's photographs (default: the rig file's)");
  command->add_option("--lobes", options->measure.fit.n_lobes, "lobes to fit")->capture_default_str()->check(CLI::Range(0, 5));
  command->add_option("--max-theta-deg", options->max_theta_deg, "leave out light and camera directions beyond this")->capture_default_str();
  command->add_flag("--calibrate-geometry", options->measure.calibrate_geometry,
                    "estimate sphere, turntable axis and lights from the images, as lacquer calibrate geometry does");
  command->add_flag("--resume", options->measure.resume, "go on with a capture that was interrupted in this session folder");
  command->add_flag("--no-checks", options->no_checks, "begin at once, without the check of the camera's exposure");
  command->add_flag("--no-report", options->no_report, "without report.html (lacquer report writes it later)");
  command->add_flag("--dry-run", options->dry_run, "only say what it would be: plan, duration, disk space, coverage of the table");
  add_json_option(*command, context);
  command->callback([options, &context] { run(*options, context); });
}

}  // namespace lacquer::tools
