#pragma once

#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <string>

#include "libacquire/devices.h"
#include "libacquire/rig_description.h"
#include "libacquire/session.h"
#include "tools/command.h"

/// What commands that photograph do before the first frame and when they end early.
namespace lacquer::tools {

/// Checks a rig's devices as capture --check: prints one line per check. Error{device} if one failed.
void print_rig_checks(acquire::Rig& rig, const acquire::RigDescription& description, const std::string& session, const Context& context);

class CaptureGuard {
 public:
  /// `checks`: the quick ones run before the first frame.
  CaptureGuard(const acquire::RigDescription& description, bool checks, const Context& context)
      : description_(description), checks_(checks), context_(context) {}

  /// For CaptureOptions::before_frames: warnings go to stderr, a check that failed is an Error{device}.
  std::function<void(acquire::Rig&)> before_frames();

  /// Runs `work`. An Error after before_frames() gets a second line: what state the rig is in, and the command that goes on.
  void run(const std::function<void()>& work) const;

 private:
  const acquire::RigDescription& description_;
  bool checks_;
  const Context& context_;
  bool begun_ = false;
};

/// What the adaptive brackets of a session saved, and what it cost: one line. Empty: it has none.
std::string bracket_text(const acquire::Session& session);

/// The same in numbers.
nlohmann::ordered_json bracket_json(const acquire::Session& session);

/// Ctrl-C only: for work that has no length, or a person in it.
Progress interruption(const Context& context);

/// `command_line` with --resume.
std::string resume_command(const std::string& command_line);

}  // namespace lacquer::tools
