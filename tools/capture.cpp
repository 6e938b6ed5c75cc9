#include <fmt/format.h>

#include <chrono>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "libacquire/open_rig.h"
#include "libacquire/session.h"
#include "libbrdf/brdf.h"
#include "libbrdf/error.h"
#include "libcalib/merge_session.h"
#include "tools/capture_guard.h"
#include "tools/capture_guided.h"
#include "tools/dry_run.h"
#include "tools/json_output.h"

namespace lacquer::tools {

namespace {

struct Options {
  std::string rig, paint, data, session;
  bool resume = false, dry_run = false, check = false, no_checks = false;
  std::string map;
  int boards = 0;
  double exposure_ms = 0, every_s = 0;
  bool white_reference = false;

  bool guided() const { return boards > 0 || white_reference; }
  acquire::GuidedPlan guided_plan() const {
    return {white_reference ? acquire::GuidedPlan::Kind::white_reference : acquire::GuidedPlan::Kind::boards, boards, exposure_ms * 1e-3};
  }
};

void run(const Options& options, const Context& context) {
  acquire::RigDescription rig = acquire::read_rig(options.rig, options.data);
  if (options.guided()) rig = acquire::parse_rig(acquire::with_guided_plan(rig, options.guided_plan()), rig.file, options.data);
  if (options.dry_run) return print_dry_run(rig, {.session = options.session, .map = options.map, .samples = {}}, context);
  if (options.session.empty() && !options.check) throw Error(ErrorCode::usage, "-o: missing; expected the folder of the session");
  std::shared_ptr<const brdf::Brdf> paint;
  if (rig.kind == acquire::RigDescription::Kind::simulated) {
    if (!options.paint.empty()) rig.simulation.paint = options.paint;
    if (rig.simulation.paint.empty())
      throw Error(ErrorCode::usage, options.rig + ": simulation.paint: missing; state it there or give --paint FILE");
    paint = brdf::load_brdf(rig.simulation.paint);
  } else if (!options.paint.empty()) {
    throw Error(ErrorCode::usage, "--paint: only a simulated rig can be given a paint");
  }

  const auto start = std::chrono::steady_clock::now();
  acquire::Rig devices = acquire::open_rig(rig, std::move(paint));
  if (options.check) return print_rig_checks(devices, rig, options.session, context);
  CaptureGuard guard(rig, !options.no_checks && !options.guided(), context);  // what the checks look at is the painted sphere
  Guide guide(rig, options.guided_plan().kind, options.every_s, context);
  acquire::Session session;
  guard.run([&] {
    acquire::CaptureOptions capture{.command_line = context.command_line, .resume = options.resume, .before_frames = guard.before_frames(),
                                    .noise = calib::bracket_noise(calib::calibration_from_rig(rig))};
    if (options.guided()) capture.before_view = guide.before_view();
    session = acquire::capture_session(devices, rig, options.session, capture, options.guided() ? interruption(context) : stderr_progress(context),
                                       options.guided() ? guide.sink() : acquire::FrameSink{});
  });
  std::size_t n_frames = 0;
  for (const acquire::ViewRecord& view : session.views) n_frames += view.frames.size();
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  if (context.json) {
    auto j = json_result(context, {(session.folder / "rig.toml").string()});
    j.update({{"session", session.folder.string()}, {"views", session.views.size()}, {"frames", n_frames}, {"seconds", seconds}});
    if (rig.adaptive_loss) j["adaptive_bracket"] = bracket_json(session);
    return print_json(j);
  }
  fmt::print("{}: {} views, {} frames, {:.1f} s\n", session.folder.string(), session.views.size(), n_frames, seconds);
  fmt::print("{}", options.guided() ? guide.end_text(session) : bracket_text(session));
}

}  // namespace

void add_capture(CLI::App& app, Context& context) {
  auto* command = app.add_subcommand("capture", "photograph a sphere as the rig file plans it: rig -> raw frames of a session");
  const auto options = std::make_shared<Options>();
  command->add_option("rig", options->rig, "rig file (TOML), e.g. rigs/simulated-quick.toml")->required();
  command->add_option("--paint", options->paint, "simulated rig: any BRDF file, instead of the rig file's simulation.paint");
  command->add_option("--data", options->data, "replay rig: folder of the photographs, instead of the rig file's replay.folder");
  command->add_option("-o,--output", options->session, "folder of the session, new or empty (or with --resume)");
  command->add_flag("--resume", options->resume, "go on with a capture that was interrupted in this folder");
  command->add_flag("--dry-run", options->dry_run, "only say what it would be: plan, duration, disk space, coverage of the table");
  command->add_flag("--check", options->check, "test the rig with a few frames, without measuring: camera, lights, turntable, free space");
  command->add_flag("--no-checks", options->no_checks, "begin at once, without the check of the camera's exposure");
  command->add_option("--map", options->map, "with --dry-run: SVG or PNG of the coverage, instead of text");
  auto* boards = command->add_option("--boards", options->boards, "guided: photographs of a chessboard, moved by you between them")->check(CLI::Range(1, 1000));
  auto* white = command->add_flag("--white-reference", options->white_reference, "guided: a white standard in the sphere's place, each light once");
  boards->excludes(white);
  command->add_option("--exposure-ms", options->exposure_ms, "with --boards: default is the middle one of the plan")->needs(boards)->check(CLI::Range(1e-6, 1e8));
  command->add_option("--every-s", options->every_s, "guided: go on after so many seconds instead of with Enter")->check(CLI::Range(0.1, 3600.0));
  for (const char* other : {"--dry-run", "--check"})
    for (CLI::Option* guided : {boards, white}) guided->excludes(command->get_option(other));
  add_json_option(*command, context);
  command->callback([options, &context] { run(*options, context); });
}

}  // namespace lacquer::tools
