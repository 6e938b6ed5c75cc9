#include "tools/command.h"

#include <fmt/format.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <csignal>
#include <memory>
#include <nlohmann/json.hpp>

#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::tools {

namespace {

using Clock = std::chrono::steady_clock;

volatile std::sig_atomic_t interrupted = 0;

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

std::string duration_text(double seconds) {
  if (seconds < 90) return fmt::format("{:.0f} s", seconds);
  return fmt::format("{:.0f} min", seconds / 60);
}

}  // namespace

Progress stderr_progress(const Context& context) {
  struct State {
    std::string stage;
    Clock::time_point started, printed;
  };
  std::signal(SIGINT, [](int) { interrupted = 1; });
  std::signal(SIGTERM, [](int) { interrupted = 1; });
  std::signal(SIGHUP, [](int) { interrupted = 1; });  // the terminal was closed or its connection lost
  const bool terminal = isatty(STDERR_FILENO) != 0;
  const bool quiet = context.quiet;
  return [state = std::make_shared<State>(), terminal, quiet](const std::string& stage, std::size_t done, std::size_t total) {
    if (interrupted) throw Error(ErrorCode::interrupted, "interrupted while " + stage + "; what was written so far is kept");
    if (quiet) return;
    const auto now = Clock::now();
    if (stage != state->stage) *state = {stage, now, now - std::chrono::hours(1)};
    const bool last = done >= total;
    const double since_print = std::chrono::duration<double>(now - state->printed).count();
    if (!last && since_print < (terminal ? 0.1 : 5.0)) return;
    state->printed = now;
    const double elapsed = seconds_since(state->started);
    std::string line = fmt::format("{:<12} {:>6}/{}", stage, done, total);
    if (last)
      line += fmt::format("  {:.1f} s", elapsed);
    else if (done > 0)
      line += "  ETA " + duration_text(elapsed / static_cast<double>(done) * static_cast<double>(total - done));
    if (terminal)
      fmt::print(stderr, "\r{:<60}{}", line, last ? "\n" : "");
    else
      fmt::print(stderr, "{}\n", line);
    std::fflush(stderr);
  };
}

std::string provenance_json(const Context& context, const std::vector<std::string>& inputs) {
  nlohmann::ordered_json j;
  j["software"] = std::string("lacquer ") + brdf::version();
  j["command"] = context.command_line;
  j["inputs"] = nlohmann::ordered_json::object();
  for (const auto& file : inputs) j["inputs"][file] = brdf::file_checksum(file);
  return j.dump();
}

}  // namespace lacquer::tools
