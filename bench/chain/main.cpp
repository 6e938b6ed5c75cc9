#include <CLI/CLI.hpp>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <map>
#include <optional>

#include "bench/chain/coarse_table.h"
#include "bench/chain/full.h"
#include "bench/chain/peers.h"
#include "bench/chain/settings.h"
#include "bench/chain/staged_run.h"
#include "bench/markdown.h"
#include "bench/radiometry/machine.h"
#include "libbrdf/brdf.h"
#include "libbrdf/files.h"
#include "libbrdf/metrics.h"
#include "tools/plot.h"

namespace {

namespace fs = std::filesystem;
using namespace lacquer;
using namespace lacquer::bench;

struct Arguments {
  bool quick = false, smoke = false, full = false;
  std::string folder = "bench-chain", document, plot, revision = "unknown revision", command = "bench_chain";
  std::vector<std::string> only;

  bool wanted(const std::string& part) const {
    if (!only.empty()) return std::find(only.begin(), only.end(), part) != only.end();
    return part != "full" || full;
  }
};

/// One setting over the paints.
struct Outcome {
  Setting setting;
  std::map<std::string, double> seconds;     ///< of each stage, mean over the paints
  double total = 0;
  std::vector<double> errors, delta_es;      ///< of each paint
  bool pareto = false;
  double median_error() const {
    std::vector<double> sorted = errors;
    std::sort(sorted.begin(), sorted.end());
    return sorted[sorted.size() / 2];
  }
};

const std::vector<std::string> all_paints{"ford-f8", "polaris-silber", "opel-titan", "bmw-339", "2k-acrylack", "white", "blue", "blue-matte"};

void add(Outcome& o, const brdf::Brdf& truth, const brdf::CookTorrance& fit, double n_paints, const std::map<std::string, double>& seconds) {
  const brdf::BrdfDifference d = brdf::compare(truth, brdf::CookTorranceBrdf(fit));
  o.errors.push_back(d.mean_abs_log);
  o.delta_es.push_back(d.delta_e_mean);
  for (const auto& [stage, s] : seconds) o.seconds[stage] += s / n_paints, o.total += s / n_paints;
}

/// Another fit, perhaps of a coarser table, of what the base measured; its times stand for the stages before.
void add_from_base(Outcome& o, const StagedRun& base, const brdf::Brdf& truth, double n_paints, const fs::path& folder) {
  auto seconds = base.seconds;
  const std::optional<brdf::HalfAngleTable> coarse = o.setting.coarse > 1 ? std::optional(coarser(base.table, o.setting.coarse)) : std::nullopt;
  if (coarse) seconds["write table"] = time_repeats(1, [&] { brdf::write_table(folder / "coarse.exr", *coarse); }).min_s;
  const auto fitted = fit::fit_table(coarse ? *coarse : base.table, o.setting.fit);
  seconds["fit"] = fitted.seconds;
  add(o, truth, fitted.model, n_paints, seconds);
}

std::vector<Outcome> run_settings(const Arguments& a, const std::vector<Setting>& list, const std::vector<std::string>& paints) {
  const fs::path root = LACQUER_SOURCE_DIR, rig_file = a.smoke ? root / "data-samples" / "tiny-rig.toml" : root / "rigs" / "simulated-quick.toml";
  const std::string text = brdf::read_text(rig_file);
  std::vector<Outcome> outcomes;
  for (const Setting& s : list) outcomes.push_back({s, {}, 0, {}, {}});
  for (const std::string& name : paints) {
    const std::shared_ptr<const brdf::Brdf> paint = brdf::load_brdf(root / "data-samples" / "paints" / (name + ".json"));
    std::optional<StagedRun> base;
    for (Outcome& o : outcomes) {
      std::fprintf(stderr, "%s: %s %s\n", name.c_str(), o.setting.knob.c_str(), o.setting.value.c_str());
      if (!o.setting.capture) {
        add_from_base(o, *base, *paint, static_cast<double>(paints.size()), a.folder);
        continue;
      }
      const fs::path session = fs::path(a.folder) / "session";
      fs::remove_all(session);
      StagedRun run = run_stages(acquire::parse_rig(edited(text, o.setting), rig_file), paint, session, o.setting.fit);
      add(o, *paint, run.model, static_cast<double>(paints.size()), run.seconds);
      if (!base) base = std::move(run);
    }
  }
  fs::remove_all(fs::path(a.folder) / "session");
  fs::remove(fs::path(a.folder) / "coarse.exr");
  for (Outcome& o : outcomes)
    o.pareto = std::none_of(outcomes.begin(), outcomes.end(), [&](const Outcome& p) {
      return p.total <= o.total && p.median_error() <= o.median_error() && (p.total < o.total || p.median_error() < o.median_error());
    });
  return outcomes;
}

double stage_seconds(const Outcome& o, const std::string& stage) {
  const auto found = o.seconds.find(stage);
  return found == o.seconds.end() ? 0 : found->second;
}

Table outcome_table(const std::vector<Outcome>& outcomes) {
  Table t{"chain", "Every knob, one at a time: time and error, over the paints", {{"knob", "value", "merge s", "tabulate s", "write table s", "fit s", "sum s", "mean abs ln, median", "worst", "dE2000, worst", "front"}}};
  for (const Outcome& o : outcomes)
    t.rows.push_back({o.setting.knob, o.setting.value, fmt::format("{:.2f}", stage_seconds(o, "merge")), fmt::format("{:.2f}", stage_seconds(o, "tabulate")),
                      fmt::format("{:.2f}", stage_seconds(o, "write table")), fmt::format("{:.2f}", stage_seconds(o, "fit")), fmt::format("{:.2f}", o.total), fmt::format("{:.5f}", o.median_error()),
                      fmt::format("{:.5f}", *std::max_element(o.errors.begin(), o.errors.end())), fmt::format("{:.3f}", *std::max_element(o.delta_es.begin(), o.delta_es.end())), o.pareto ? "yes" : ""});
  return t;
}

/// Least-squares slope of ln(seconds) over ln(work).
Table slope_table(const std::vector<Outcome>& outcomes) {
  Table t{"slopes", "How cost grows: slope of ln(time) over ln(work)", {{"work", "stage", "values", "slope"}}};
  const std::map<std::string, std::pair<double, std::vector<std::string>>> of_knob{{"exposures per view", {8, {"merge"}}},
                                                                                    {"lights per half turn", {61, {"merge", "tabulate"}}},
                                                                                    {"image size", {480 * 360, {"merge", "tabulate"}}},
                                                                                    {"cells in the fit", {0, {"fit"}}},
                                                                                    {"table resolution", {90, {"write table", "fit"}}}};
  for (const auto& [knob, what] : of_knob)
    for (const std::string& stage : what.second) {
      std::vector<std::pair<double, double>> points;
      for (const Outcome& o : outcomes) {
        const double work = o.setting.knob == knob ? o.setting.work : o.setting.knob == "base" ? what.first : 0;
        if (work > 0 && stage_seconds(o, stage) > 0) points.emplace_back(std::log(work), std::log(stage_seconds(o, stage)));
      }
      if (points.size() < 2) continue;
      double sx = 0, sy = 0, sxx = 0, sxy = 0;
      for (const auto& [x, y] : points) sx += x, sy += y, sxx += x * x, sxy += x * y;
      const double n = static_cast<double>(points.size());
      t.rows.push_back({knob, stage, fmt::format("{}", points.size()), fmt::format("{:.2f}", (n * sxy - sx * sy) / (n * sxx - sx * sx))});
    }
  return t;
}

Table machine_table(const Arguments& a) {
  const Machine machine = describe_machine();
  const std::size_t n = a.smoke ? 1u << 20 : 1u << 26;
  const MemoryLimits memory = measure_memory(n, 3);
  const DiskRate disk = measure_disk(a.folder, a.smoke ? 8u << 20 : 512u << 20);
  const std::time_t now = std::time(nullptr);
  char date[20];
  std::strftime(date, sizeof date, "%Y-%m-%d", std::gmtime(&now));
  Table t{"machine", "Machine", {{"what", "value"}}};
  t.rows.push_back({"machine", fmt::format("{}, {} cores", machine.cpu, machine.cores)});
  t.rows.push_back({"date, revision, version", fmt::format("{}, {}, {}", date, a.revision, brdf::version())});
  t.rows.push_back({"command", "`" + a.command + "`"});
  t.rows.push_back({"memory, streaming read", fmt::format("{:.1f} GB/s", 2 * memory.n_values / memory.read_16bit.min_s / 1e9)});
  t.rows.push_back({"memory, copy", fmt::format("{:.1f} GB/s", 2 * memory.n_values / memory.copy.min_s / 1e9)});
  t.rows.push_back({"disk, write and sync", fmt::format("{:.2f} GB/s", disk.write / 1e9)});
  t.rows.push_back({"disk, read, not cached", fmt::format("{:.2f} GB/s", disk.read / 1e9)});
  return t;
}

Table full_table(const Arguments& a) {
  Table t{"full", "The paper's plan, 181 x 16 frames of 1360 x 1024 at 16 bit, from raw frames on disk to parameters", {{"stage", "seconds", "peak memory MB"}}};
  const fs::path root = LACQUER_SOURCE_DIR, rig_file = fs::path(a.folder) / "full.toml", paint = root / "data-samples" / "paints" / "polaris-silber.json";
  Setting sixteen{"", "", 0, {{"bits = 12", "bits = 16"}, {"black_level_dn = 64", "black_level_dn = 1024"}, {"gain_e_per_dn = 4.2", "gain_e_per_dn = 0.2625"},
                              {"../data-samples/paints/polaris-silber.json", paint.filename().string()}}, {}, true};
  fs::copy_file(paint, fs::path(a.folder) / paint.filename(), fs::copy_options::overwrite_existing);  // the frames may be another checkout's
  brdf::write_text_atomically(rig_file, edited(brdf::read_text(root / "rigs" / "simulated-paper.toml"), sixteen));
  const FullRun full = run_full(a.folder, rig_file, paint);
  t.rows.push_back({fmt::format("raw frames read once, {:.2f} GB, not cached", full.raw_bytes / 1e9), fmt::format("{:.1f}", full.read_once_s), ""});
  for (const auto& stage : full.stages) t.rows.push_back({"lacquer " + stage.name, fmt::format("{:.1f}", stage.seconds), fmt::format("{:.0f}", stage.peak_mb)});
  const double allowed = 1.5 * full.read_once_s + 10;
  t.rows.push_back({fmt::format("sum; asked: at most {:.1f} (1.5 times the reading + 10)", allowed), fmt::format("{:.1f}{}", full.total_s, full.total_s <= allowed ? "" : ", **missed**"), ""});
  t.rows.push_back({"mean abs ln(fit / truth)", fmt::format("{:.5f}", full.mean_abs_log), ""});
  return t;
}

void plot(const std::vector<Outcome>& outcomes, const fs::path& output) {
  std::string data, curves;
  std::vector<std::string> knobs;
  for (const Outcome& o : outcomes)
    if (std::find(knobs.begin(), knobs.end(), o.setting.knob) == knobs.end()) knobs.push_back(o.setting.knob);
  for (std::size_t k = 0; k < knobs.size(); ++k) {
    std::vector<std::vector<double>> columns(2);
    for (const Outcome& o : outcomes)
      if (o.setting.knob == knobs[k]) columns[0].push_back(o.total), columns[1].push_back(o.median_error());
    data += tools::plot_data(fmt::format("k{}", k), columns);
    curves += fmt::format(", $k{} using 1:2 with points pt {} ps 1.1 lt {} title {}", k, k == 0 ? 5 : 7, k % 8 + 1, tools::plot_text(knobs[k]));
  }
  std::vector<std::pair<double, double>> front;
  for (const Outcome& o : outcomes)
    if (o.pareto) front.emplace_back(o.total, o.median_error());
  std::sort(front.begin(), front.end());
  std::vector<std::vector<double>> columns(2);
  for (const auto& [x, y] : front) columns[0].push_back(x), columns[1].push_back(y);
  tools::gnuplot(data + tools::plot_data("front", columns) +
                     "set logscale xy\nset xlabel 'merge, tabulate, write and fit / s'\nset ylabel 'mean |ln(fit / truth)|, median of the paints'\nset key outside right top\n"
                     "plot $front using 1:2 with lines lw 1 lc rgb grey title 'front'" + curves + "\n",
                 output, {860, 520});
}

int run(const Arguments& a) {
  fs::create_directories(a.folder);
  std::vector<Setting> list = settings(a.quick || a.smoke);
  std::vector<std::string> paints = a.quick ? std::vector<std::string>{"polaris-silber", "blue"} : all_paints;
  if (a.smoke) {
    paints = {"polaris-silber"};
    std::erase_if(list, [](const Setting& s) { return !s.edits.empty(); });
  }
  std::vector<Table> tables{machine_table(a)};
  std::vector<Outcome> outcomes;
  if (a.wanted("peers")) tables.push_back({"peers", "Beside other programs and plain loops", peer_rows(a.folder, a.smoke)});
  if (a.wanted("knobs")) {
    outcomes = run_settings(a, list, paints);
    tables.push_back(outcome_table(outcomes));
    tables.push_back(slope_table(outcomes));
  }
  if (a.wanted("full")) tables.push_back(full_table(a));
  for (const Table& t : tables) fmt::print("\n{}\n\n{}", t.title, as_markdown(t));
  if (!a.plot.empty() && !outcomes.empty()) plot(outcomes, a.plot);
  if (!a.document.empty()) write_into(a.document, tables);
  for (const Outcome& o : outcomes)
    for (const double e : o.errors)
      if (!std::isfinite(e)) return 1;
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("The whole chain on the simulated rig over its accuracy knobs: error beside time");
  Arguments a;
  app.add_flag("--quick", a.quick, "two paints, two values per knob");
  app.add_flag("--smoke", a.smoke, "a tiny session: that it runs");
  app.add_flag("--full", a.full, "also the paper's plan from raw frames on disk (12 GB in --folder, minutes the first time)");
  app.add_option("--only", a.only, "parts of the document to renew, beside the machine's table")->check(CLI::IsMember({"peers", "knobs", "full"}));
  app.add_option("--folder", a.folder, "for sessions; the frames of --full stay in it for the next run");
  app.add_option("--document", a.document, "Markdown file whose tables are replaced");
  app.add_option("--plot", a.plot, "error against time, .svg or .png");
  app.add_option("--revision", a.revision, "revision of the sources, for the record");
  app.add_option("--command", a.command, "command that was typed, for the record");
  CLI11_PARSE(app, argc, argv);
  try {
    return run(a);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "bench_chain: %s\n", e.what());
    return 1;
  }
}
