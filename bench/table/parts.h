#pragma once

#include <filesystem>

/// Parts of bench_table; each prints a table of its own. `smoke`: small, to see that it runs.
namespace lacquer::bench {

void accumulation(const std::filesystem::path& source, bool smoke);
void filling(const std::filesystem::path& source, const std::filesystem::path& shared, bool smoke);
void discretisation(const std::filesystem::path& source, bool smoke);
void lookup(const std::filesystem::path& source, bool smoke);
void parameterisations(const std::filesystem::path& source, const std::filesystem::path& plot, bool smoke);

}  // namespace lacquer::bench
