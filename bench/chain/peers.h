#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace lacquer::bench {

/// Rows stage, what, seconds, error: each stage of ours and beside it what others, or a plain loop, do with the same data. `small`: that it runs.
std::vector<std::vector<std::string>> peer_rows(const std::filesystem::path& folder, bool small);

}  // namespace lacquer::bench
