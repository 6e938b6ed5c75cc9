#pragma once

#include <functional>
#include <string>

#include "libacquire/guided_plan.h"
#include "libacquire/session.h"
#include "tools/command.h"

/// Captures during which a person moves something between the views.
namespace lacquer::tools {

/// Prompts on stderr, and goes on with each line of stdin, or every `every_s` seconds (> 0).
class Guide {
 public:
  Guide(const acquire::RigDescription& rig, acquire::GuidedPlan::Kind kind, double every_s, const Context& context);

  /// For CaptureOptions::before_view: waits for the person. Throws Error{input} when stdin ends, Error{interrupted}.
  std::function<void(std::size_t)> before_view();
  /// Says of each frame how bright it is.
  acquire::FrameSink sink() const;
  /// Where the frames are.
  std::string end_text(const acquire::Session& session) const;

 private:
  void wait(const std::string& prompt, const std::string& what) const;

  const acquire::RigDescription& rig_;
  acquire::GuidedPlan::Kind kind_;
  double every_s_;
  bool quiet_;
  Progress interruption_;
  bool white_there_ = false;
};

}  // namespace lacquer::tools
