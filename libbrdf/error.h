#pragma once

#include <stdexcept>
#include <string>

namespace lacquer {

/// What kind of boundary an error came from; the tools turn `usage` into exit code 2, everything else into 1.
enum class ErrorCode { usage, input, file, device, timeout, interrupted };

/// The one exception of Lacquer. The text is one line for a user: file, field, what was expected, what to do,
/// e.g. "rig.toml: lights[3].position_mm: expected 3 numbers, got 2".
class Error : public std::runtime_error {
 public:
  Error(ErrorCode code, const std::string& text) : std::runtime_error(text), code_(code) {}
  ErrorCode code() const { return code_; }

 private:
  ErrorCode code_;
};

}  // namespace lacquer
