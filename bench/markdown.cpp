#include "bench/markdown.h"

#include <fmt/format.h>

#include <algorithm>

#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::bench {

std::string as_markdown(const Table& table) {
  std::vector<std::size_t> widths(table.rows.front().size());
  for (const auto& row : table.rows)
    for (std::size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], row[i].size());
  std::string text;
  for (std::size_t k = 0; k < table.rows.size(); ++k) {
    for (std::size_t i = 0; i < widths.size(); ++i) text += fmt::format("| {:{}} ", table.rows[k][i], widths[i]);
    text += "|\n";
    if (k > 0) continue;
    for (const std::size_t w : widths) text += "|" + std::string(w + 2, '-');
    text += "|\n";
  }
  return text;
}

void write_into(const std::filesystem::path& document, const std::vector<Table>& tables) {
  std::string text = brdf::read_text(document);
  for (const Table& t : tables) {
    const std::string begin = fmt::format("<!-- table {} -->\n", t.name), end = "<!-- end -->";
    const std::size_t from = text.find(begin), to = text.find(end, from);
    if (from == std::string::npos || to == std::string::npos)
      throw Error(ErrorCode::file, fmt::format("{}: expected \"<!-- table {} -->\" ... \"<!-- end -->\"", document.string(), t.name));
    text.replace(from + begin.size(), to - from - begin.size(), as_markdown(t));
  }
  brdf::write_text_atomically(document, text);
}

}  // namespace lacquer::bench
