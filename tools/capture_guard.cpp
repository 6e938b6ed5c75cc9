#include "tools/capture_guard.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "libacquire/capture_estimate.h"
#include "libacquire/rig_check.h"
#include "libbrdf/error.h"
#include "tools/dry_run.h"
#include "tools/json_output.h"

namespace lacquer::tools {

namespace {

using acquire::RigCheck;

/// After a fault of a device the turntable may have switched its motor off, and says so itself.
const char* safe_state(ErrorCode code) {
  return code == ErrorCode::device || code == ErrorCode::timeout ? "lights off, motor stopped" : "lights off, motor held";
}

}  // namespace

void print_rig_checks(acquire::Rig& rig, const acquire::RigDescription& description, const std::string& session, const Context& context) {
  if (!context.json) fmt::print("camera: {}\nturntable: {}\nlights: {}\n", rig.camera->description(), rig.turntable->description(), rig.lights->description());
  std::fflush(stdout);
  std::vector<RigCheck> checks{acquire::check_free_space(description, session)};
  const auto of_devices = acquire::check_rig(rig, description, acquire::CheckExtent::full, interruption(context));
  checks.insert(checks.end(), of_devices.begin(), of_devices.end());
  std::size_t n_failed = 0;
  auto j = json_result(context, {description.file.string()});
  j.update({{"camera", rig.camera->description()}, {"turntable", rig.turntable->description()}, {"lights", rig.lights->description()}});
  for (const RigCheck& check : checks) {
    const bool failed = check.verdict == RigCheck::Verdict::failed, warning = check.verdict == RigCheck::Verdict::warning;
    n_failed += failed;
    const std::string verdict = failed ? "FAILED" : warning ? "warning" : "good";
    j["checks"].push_back({{"name", check.name}, {"verdict", failed ? "failed" : verdict}, {"text", check.text}});
    if (!context.json)
      fmt::print("{}{}{}: {}\n", emphasised(verdict, failed ? Emphasis::error : warning ? Emphasis::warning : Emphasis::good, stdout), std::string(8 - verdict.size(), ' '), check.name, check.text);
  }
  if (context.json) print_json(j);
  if (n_failed) throw Error(ErrorCode::device, fmt::format("{}: {} of {} checks failed", description.file.string(), n_failed, checks.size()));
}

std::function<void(acquire::Rig&)> CaptureGuard::before_frames() {
  return [this](acquire::Rig& rig) {
    const std::string camera_warning = rig.camera->warning();
    if (!checks_ && !camera_warning.empty() && !context_.quiet)
      fmt::print(stderr, "{} camera: {}: {}\n", emphasised("lacquer: note:", Emphasis::warning, stderr), rig.camera->description(), camera_warning);
    if (checks_)
      for (const RigCheck& check : acquire::check_rig(rig, description_, acquire::CheckExtent::quick, interruption(context_))) {
        if (check.verdict == RigCheck::Verdict::failed)
          throw Error(ErrorCode::device, fmt::format("{}: {} (--no-checks captures all the same)", check.name, check.text));
        if (check.verdict == RigCheck::Verdict::warning && !context_.quiet)
          fmt::print(stderr, "{} {}: {}\n", emphasised("lacquer: note:", Emphasis::warning, stderr), check.name, check.text);
      }
    begun_ = true;
  };
}

void CaptureGuard::run(const std::function<void()>& work) const {
  try {
    work();
  } catch (const Error& e) {
    if (!begun_) throw;
    // Photographs that exist already have neither lights nor motor, and what ends their replay is mostly the rig file.
    const std::string state = description_.kind == acquire::RigDescription::Kind::replay ? "after a change of the rig file: into another folder; else" : fmt::format("{};", safe_state(e.code()));
    throw Error(e.code(), fmt::format("{}\nlacquer: {} resume with: {}", e.what(), state, resume_command(context_.command_line)));
  }
}

Progress interruption(const Context& context) {
  Context silent = context;
  silent.quiet = true;
  return stderr_progress(silent);
}

std::string bracket_text(const acquire::Session& session) {
  if (!session.rig.adaptive_loss) return "";
  const acquire::BracketSavings s = acquire::bracket_savings(session);
  return fmt::format("adaptive bracket: {} of {} frames left out, {} saved; predicted loss of sigma: {:.2f} % mean, {:.1f} % at most\n", s.n_left_out, s.n_planned,
                     duration_text(s.seconds), 100 * s.mean_loss, 100 * s.largest_loss);
}

nlohmann::ordered_json bracket_json(const acquire::Session& session) {
  const acquire::BracketSavings s = acquire::bracket_savings(session);
  return {{"planned", s.n_planned}, {"left_out", s.n_left_out}, {"saved_s", s.seconds}, {"predicted_mean_loss", s.mean_loss}, {"predicted_largest_loss", s.largest_loss}};
}

std::string resume_command(const std::string& command_line) {
  return (command_line + " ").find(" --resume ") != std::string::npos ? command_line : command_line + " --resume";
}

}  // namespace lacquer::tools
