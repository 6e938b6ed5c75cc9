#pragma once

#include <filesystem>

/// Parts of bench_table; each prints a table of its own.
namespace lacquer::bench {

void accumulation(const std::filesystem::path& source, bool smoke);

}  // namespace lacquer::bench
