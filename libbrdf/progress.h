#pragma once

#include <cstddef>
#include <functional>
#include <string>

namespace lacquer {

/// Called from long work, always from the calling thread: `done` of `total` steps of `stage`. May throw
/// Error{interrupted} to stop the work; libraries then leave everything already written intact.
using Progress = std::function<void(const std::string& stage, std::size_t done, std::size_t total)>;

}  // namespace lacquer
