#pragma once

#include <filesystem>
#include <string>
#include <vector>

/// Tables of results for people and for documents.
namespace lacquer::bench {

struct Table {
  std::string name;                    ///< of the place in the document
  std::string title;
  std::vector<std::vector<std::string>> rows;  ///< the first is the header
};

/// Columns padded: reads well as text and is Markdown.
std::string as_markdown(const Table& table);

/// Replaces what stands between "<!-- table NAME -->" and "<!-- end -->" in `document`. Throws Error where a table has no such place.
void write_into(const std::filesystem::path& document, const std::vector<Table>& tables);

}  // namespace lacquer::bench
