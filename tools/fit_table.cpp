#include "tools/fit_table.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "libbrdf/error.h"

namespace lacquer::tools {

namespace {

std::size_t most_lobes(const std::vector<NamedFit>& fits) {
  std::size_t n = 0;
  for (const NamedFit& f : fits) n = std::max(n, f.fit.model.lobes.size());
  return n;
}

const fit::Parameter* find(const fit::FitResult& fit, const std::string& name) {
  for (const fit::Parameter& p : fit.parameters)
    if (p.name == name) return &p;
  return nullptr;
}

/// Of a colour's channel: its own, the grey lobe's common one or the only one of a one-channel table.
const fit::Parameter* find(const fit::FitResult& fit, const std::string& stem, char channel) {
  for (const std::string& name : {fmt::format("{}.{}", stem, channel), stem, stem + ".y"})
    if (const fit::Parameter* p = find(fit, name)) return p;
  return nullptr;
}

/// A comma, a quote or a line's end in a name would end its field.
std::string csv_field(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

std::string csv(const std::vector<NamedFit>& fits) {
  struct Column {
    std::string name, stem;
    char channel;  ///< 0: none
  };
  std::vector<Column> columns;
  const auto add_colour = [&](const std::string& stem) {
    for (const char c : {'r', 'g', 'b'}) columns.push_back({fmt::format("{}.{}", stem, c), stem, c});
  };
  add_colour("kd");
  for (std::size_t l = 1; l <= most_lobes(fits); ++l) {
    add_colour(fmt::format("ks{}", l));
    for (const char* shape : {"m", "r"}) columns.push_back({fmt::format("{}{}", shape, l), fmt::format("{}{}", shape, l), 0});
  }
  std::string text = "paint,structure,mean_abs_log,shared_error,reduced_chi2";
  for (const Column& c : columns) text += fmt::format(",{},{}_sigma", c.name, c.name);
  text += "\n";
  for (const NamedFit& f : fits) {
    text += fmt::format("{},{},{:.6g},{:.6g},{:.6g}", csv_field(f.name), csv_field(f.fit.candidates.front().structure), f.fit.mean_abs_log,
                        f.fit.shared_error, f.fit.reduced_chi2);
    for (const Column& c : columns) {
      const fit::Parameter* p = c.channel ? find(f.fit, c.stem, c.channel) : find(f.fit, c.stem);
      text += p ? fmt::format(",{:.9g},{}", p->value, p->determined ? fmt::format("{:.3g}", p->sigma) : std::string("undetermined")) : ",,";
    }
    text += "\n";
  }
  return text;
}

/// Text of a paint's name in LaTeX.
std::string latex(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    if (std::string("#$%&_{}").find(c) != std::string::npos) escaped += '\\';
    escaped += c == '\\' || c == '~' || c == '^' ? ' ' : c;
  }
  return escaped;
}

/// Rows of cells, the first one the heading.
std::vector<std::vector<std::string>> rows(const std::vector<NamedFit>& fits, bool tex) {
  const std::size_t n = most_lobes(fits);
  std::vector<std::vector<std::string>> table{{"paint", "", "kd"}};
  for (std::size_t l = 1; l <= n; ++l)
    for (const char* stem : {"ks", "m", "r"}) table[0].push_back(fmt::format("{}{}", stem, l));
  table[0].push_back(tex ? "mean $|\\ln|$" : "mean abs ln");
  const auto cell = [&](const fit::Parameter* p) -> std::string {
    if (!p) return "";
    if (!p->determined) return "?";
    const std::string text = with_error(p->value, p->sigma, tex ? "\\pm" : "±");
    return (tex ? "$" + text + "$" : text) + (p->at_bound ? tex ? "$^b$" : " (bound)" : "");
  };
  for (const NamedFit& f : fits)
    for (const char channel : f.fit.parameters.front().name.ends_with(".y") ? std::string("y") : std::string("rgb")) {
      const bool first = channel == 'r' || channel == 'y';
      std::vector<std::string> row{first ? tex ? latex(f.name) : f.name : "", std::string(1, channel), cell(find(f.fit, "kd", channel))};
      for (std::size_t l = 1; l <= n; ++l) {
        row.push_back(cell(find(f.fit, fmt::format("ks{}", l), channel)));
        for (const char* stem : {"m", "r"}) row.push_back(first ? cell(find(f.fit, fmt::format("{}{}", stem, l))) : "");
      }
      row.push_back(first ? fmt::format("{:.4g}", f.fit.mean_abs_log) : "");
      table.push_back(std::move(row));
    }
  return table;
}

std::string joined(const std::vector<std::string>& cells, const char* before, const char* between, const char* after) {
  return before + fmt::format("{}", fmt::join(cells, between)) + after;
}

}  // namespace

std::string with_error(double value, double sigma, const char* sign) {
  if (!(sigma > 0)) return fmt::format("{:.6g}", value);
  const int decimals = std::clamp(1 - static_cast<int>(std::floor(std::log10(sigma))), 0, 12);
  return fmt::format("{:.{}f} {} {:.{}f}", value, decimals, sign, sigma, decimals);
}

std::string with_error_aligned(double value, double sigma, int before, int after) {
  const std::string text = with_error(value, sigma);
  const std::size_t at = std::min(text.find(" ±"), text.size());
  return fmt::format("{:>{}}{:<{}}", text.substr(0, at), before, text.substr(at), after);
}

TableFormat table_format(const std::string& file) {
  const std::string extension = std::filesystem::path(file).extension().string();
  if (extension == ".csv") return TableFormat::csv;
  if (extension == ".md") return TableFormat::markdown;
  if (extension == ".tex") return TableFormat::latex;
  throw Error(ErrorCode::usage, fmt::format("--table: expected a file ending in .csv, .md or .tex, got {}", file));
}

std::string fit_table_text(const std::vector<NamedFit>& fits, TableFormat format) {
  if (format == TableFormat::csv) return csv(fits);
  const bool tex = format == TableFormat::latex;
  const auto table = rows(fits, tex);
  std::string text = tex ? fmt::format("\\begin{{tabular}}{{ll{}}}\n\\hline\n", std::string(table[0].size() - 2, 'r')) : "";
  for (std::size_t i = 0; i < table.size(); ++i) {
    text += tex ? joined(table[i], "", " & ", " \\\\\n") : joined(table[i], "| ", " | ", " |\n");
    if (i == 0) text += tex ? "\\hline\n" : joined(std::vector<std::string>(table[0].size(), "---"), "|", "|", "|\n");
  }
  return text + (tex ? "\\hline\n\\end{tabular}\n" : "");
}

}  // namespace lacquer::tools
