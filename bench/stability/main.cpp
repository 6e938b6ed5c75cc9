#include <CLI/CLI.hpp>

#include <algorithm>
#include <cstdio>

#include "bench/markdown.h"
#include "bench/stability/hard_case.h"

namespace {

using namespace lacquer::bench;

struct Stage {
  const char *name, *title;
  HardCases (*run)();
};
constexpr Stage stages[]{{"response", "Response", response_cases},     {"merge", "Merge", merge_cases},   {"geometry", "Geometry", geometry_cases},
                         {"table", "Table", table_cases},              {"filling", "Filling", filling_cases}, {"fit", "Fit", fit_cases},
                         {"formats", "Formats", format_cases},         {"evaluation", "Evaluation", evaluation_cases}};

Table as_table(const Stage& stage, const HardCases& cases) {
  Table t{stage.name, stage.title, {{"case", "what happens", "figure"}}};
  for (const HardCase& c : cases) t.rows.push_back({c.what, c.happens, c.figure + (c.holds ? "" : " **does not hold**")});
  return t;
}

int run(const std::vector<std::string>& chosen, const std::string& document) {
  std::vector<Table> tables;
  bool all_hold = true;
  for (const Stage& stage : stages) {
    if (!chosen.empty() && std::find(chosen.begin(), chosen.end(), stage.name) == chosen.end()) continue;
    const HardCases cases = stage.run();
    for (const HardCase& c : cases) all_hold = all_hold && c.holds;
    tables.push_back(as_table(stage, cases));
    fmt::print("\n{}\n\n{}", stage.title, as_markdown(tables.back()));
    std::fflush(stdout);
  }
  if (!document.empty()) write_into(document, tables);
  return all_hold ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Hard cases of every stage, with the figure that each gives; fails where one is not as documented");
  std::vector<std::string> chosen;
  std::string document;
  std::vector<std::string> names;
  for (const Stage& s : stages) names.emplace_back(s.name);
  app.add_option("stages", chosen, "which; none: all")->check(CLI::IsMember(names));
  app.add_option("--document", document, "Markdown file whose tables are replaced");
  CLI11_PARSE(app, argc, argv);
  try {
    return run(chosen, document);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "bench_stability: %s\n", e.what());
    return 1;
  }
}
