#include <CLI/CLI.hpp>
#include <fmt/format.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>

#include "bench/radiometry/report.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libcalib/merge.h"
#include "tools/plot.h"

namespace {

using namespace lacquer::bench;

struct Arguments {
  bool smoke = false, ours = false;
  std::string output = "bench-radiometry", document, plot, revision = "unknown revision", command = "bench_radiometry";
};

void progress(const std::string& text) {
  std::fprintf(stderr, "%s\n", text.c_str());
}

std::string today() {
  const std::time_t now = std::time(nullptr);
  char text[20];
  std::strftime(text, sizeof text, "%Y-%m-%d", std::gmtime(&now));
  return text;
}

std::filesystem::path shared_data() {
  const char* elsewhere = std::getenv("LACQUER_SHARED_DATA");
  return elsewhere ? elsewhere : LACQUER_SHARED_DATA;
}

Results measure(const Arguments& a) {
  CaseOptions options;
  if (a.smoke) options = {2, 1, 500, 5};
  const Scene scene = a.smoke ? make_scene(97, 73) : make_scene(1360, 1024);
  const std::filesystem::path files = std::filesystem::path(a.output) / "files";
  std::filesystem::create_directories(files);
  Results r;
  r.command = a.command, r.date = today(), r.revision = a.revision;
  r.machine = describe_machine();
  r.versions = peer_versions();
  r.width = scene.width, r.height = scene.height;
  r.times = exposure_times(0.25e-3, 328e-3, 16);
  r.memory = measure_memory(scene.light.size() * r.times.size(), options.merge_repeats);
  r.weights = weight_losses();
  for (const ToneCurve& curve : {gamma_curve(), film_curve(), linear_curve()})
    for (const int bits : {8, 12, 16}) {
      // Small runs have each curve and each depth once.
      if (a.smoke && bits != (curve.linear ? 16 : curve.name == "film" ? 12 : 8)) continue;
      progress(fmt::format("{}, {} bit", curve.name, bits));
      // A curved sensor (or its firmware) subtracts black and cuts negative noise off before the curve; a linear one keeps its black level.
      const Sensor sensor{bits, curve, curve.linear ? std::exp2(bits - 6) : 0.0};
      const Stack stack = take_stack(sensor, scene, r.times, 1);
      const ReferenceImage reference = merge_reference(stack, stack.truth);
      const auto valid = valid_values(stack, reference);
      r.cases.push_back(run_case(stack, reference, valid, options));
      if (r.cases.size() == 1 && !a.ours) {
        progress("the others, of which OpenCV's response takes longest");
        r.peers = run_peers(stack, valid, files, options);
      }
      if (curve.linear && (bits == 12 || a.smoke)) {
        progress("OpenEXR compressions");
        r.compressions =
            measure_compressions(lacquer::calib::merge_bracket(stack.frames, sensor.response(), sensor.noise()), files, a.smoke ? 1 : 3);
      }
    }
  if (!a.smoke && !a.ours) {
    progress("memorial");
    r.memorial = compare_memorial(shared_data() / "brackets/memorial");
  }
  std::filesystem::remove_all(files);
  return r;
}

/// What a smoke run can judge: nothing about time.
bool plausible(const Results& r) {
  bool good = true;
  const auto expect = [&](bool condition, const CaseResult& c, const std::string& what) {
    if (!condition) progress(fmt::format("{}, {} bit: {}", c.curve, c.bits, what));
    good &= condition;
  };
  for (const CaseResult& c : r.cases) {
    // 20 000 values: the spread is known to 0.5 %, an error ratio to 1 %.
    expect(std::abs(c.reference_spread - 1) < 0.03, c, fmt::format("reference: expected errors of 1 sigma, got {:.4f}", c.reference_spread));
    expect(c.known.median < 1.03 * c.reference.median, c, fmt::format("known response: error {:.5f}, reference {:.5f}", c.known.median, c.reference.median));
    expect(c.estimated.median < 1.1 * c.reference.median, c, fmt::format("estimated response: error {:.5f}, reference {:.5f}", c.estimated.median, c.reference.median));
    expect(c.estimated.not_finite == 0 && c.estimated.n_clipped > 0 && c.estimated.clipped_below_bound == 0, c, "clipped values lost or not finite");
    for (const LevelStatistics& l : c.levels_known)
      if (l.log10_signal >= -2) expect(std::abs(l.standard_deviation - 1) < 0.1, c, fmt::format("sigma at 1e{}: {:.3f}", l.log10_signal, l.standard_deviation));
  }
  for (const PeerCase& p : r.peers)
    if (p.result.unavailable.starts_with("failed")) progress(p.result.name + ": " + p.result.unavailable), good = false;
  return good;
}

int run(const Arguments& a) {
  namespace fs = std::filesystem;
  const Results r = measure(a);
  const auto tables = tables_of(r);
  for (const Table& t : tables) fmt::print("\n{}\n\n{}", t.title, as_markdown(t));
  lacquer::brdf::write_text_atomically(fs::path(a.output) / "radiometry.json", as_json(r));
  if (!a.plot.empty()) lacquer::tools::gnuplot(plot_script(r), a.plot, {800, 520});
  if (!a.document.empty()) write_into(a.document, tables);
  return a.smoke && !plausible(r) ? 1 : 0;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Response, noise and merge of brackets of known radiance: error beside time, the reference and other programs");
  Arguments a;
  app.add_flag("--smoke", a.smoke, "tiny stacks; exit 1 where an error is not plausible");
  app.add_flag("--ours", a.ours, "without the other programs");
  app.add_option("--output", a.output, "folder for radiometry.json");
  app.add_option("--document", a.document, "Markdown file whose tables are replaced");
  app.add_option("--plot", a.plot, "error against time, .svg or .png");
  app.add_option("--revision", a.revision, "revision of the sources, for the record");
  app.add_option("--command", a.command, "command that was typed, for the record");
  CLI11_PARSE(app, argc, argv);
  try {
    return run(a);
  } catch (const lacquer::Error& e) {
    std::fprintf(stderr, "bench_radiometry: %s\n", e.what());
    return 1;
  }
}
