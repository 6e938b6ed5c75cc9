#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "bench/radiometry/report.h"
#include "tools/plot.h"

namespace lacquer::bench {

namespace {

using Json = nlohmann::ordered_json;

Json json(const Timing& t) {
  return t.repeats ? Json{{"min_s", t.min_s}, {"median_s", t.median_s}, {"repeats", t.repeats}} : Json(nullptr);
}

Json json(const RadianceError& e) {
  return {{"median", e.median}, {"percentile95", e.percentile95}, {"n", e.n}, {"not_finite", e.not_finite}, {"scale", e.scale},
          {"n_clipped", e.n_clipped}, {"clipped_below_bound", e.clipped_below_bound}};
}

Json json(const ResponseError& e) {
  return {{"rms_ln", e.rms}, {"largest_ln", e.largest}, {"lowest_level", e.lowest}, {"highest_level", e.highest}, {"levels", e.levels}};
}

Json json(const std::vector<LevelStatistics>& levels) {
  Json array = Json::array();
  for (const LevelStatistics& l : levels)
    array.push_back({{"log10_signal", l.log10_signal}, {"n", l.n}, {"mean", l.mean}, {"standard_deviation", l.standard_deviation}});
  return array;
}

Json json(const CaseResult& c) {
  return {{"curve", c.curve}, {"bits", c.bits}, {"reference_spread", c.reference_spread}, {"reference", json(c.reference)},
          {"known", json(c.known)}, {"estimated", json(c.estimated)}, {"response", json(c.response)}, {"converged", c.converged},
          {"response_error", json(c.response_error)}, {"noise", json(c.noise)}, {"merge_known", json(c.merge_known)},
          {"merge", json(c.merge)}, {"levels_known", json(c.levels_known)}, {"levels_estimated", json(c.levels_estimated)}};
}

Json json(const PeerCase& p) {
  Json j{{"name", p.result.name}};
  if (!p.result.unavailable.empty()) {
    j["unavailable"] = p.result.unavailable;
    return j;
  }
  j["error"] = json(p.error);
  if (p.response_error.levels) j["response_error"] = json(p.response_error);
  j["response"] = json(p.result.response), j["merge"] = json(p.result.merge), j["whole"] = json(p.result.whole);
  return j;
}

Json json(const Agreement& a, const Timing& t) {
  return {{"log2_correlation", a.correlation}, {"percentile5", a.percentile5}, {"percentile95", a.percentile95}, {"seconds", t.min_s}};
}

}  // namespace

std::string as_json(const Results& r) {
  Json j{{"version", 1}, {"command", r.command}, {"date", r.date}, {"revision", r.revision}, {"cpu", r.machine.cpu},
         {"cores", r.machine.cores}, {"versions", r.versions}, {"width", r.width}, {"height", r.height}, {"times_s", r.times}};
  j["memory"] = {{"values", r.memory.n_values}, {"read_8bit", json(r.memory.read_8bit)}, {"read_16bit", json(r.memory.read_16bit)},
                 {"copy", json(r.memory.copy)}};
  for (const CaseResult& c : r.cases) j["cases"].push_back(json(c));
  for (const PeerCase& p : r.peers) j["peers"].push_back(json(p));
  if (r.memorial)
    j["memorial"] = {{"ours", json(r.memorial->ours, r.memorial->ours_s)}, {"opencv", json(r.memorial->opencv, r.memorial->opencv_s)}};
  for (const WeightLoss& w : r.weights)
    j["weights"].push_back({{"sensor", w.sensor}, {"frames", w.frames}, {"decades", w.decades}, {"median", w.median}, {"largest", w.largest}});
  for (const CompressionResult& c : r.compressions)
    j["compressions"].push_back({{"name", c.name}, {"lossy", c.lossy}, {"write", json(c.write)}, {"read", json(c.read)},
                                 {"megabytes", c.megabytes}, {"largest_change_sigmas", c.largest_change}});
  for (const Target& t : targets_of(r)) j["targets"].push_back({{"what", t.what}, {"asked", t.asked}, {"found", t.found}, {"met", t.met}});
  return j.dump(1) + "\n";
}

std::string plot_script(const Results& r) {
  const CaseResult& ours = r.cases.front();
  std::string script, lines;
  int n_lines = 0;
  const auto label = [&](double time_s, double error, const std::string& where, const std::string& name) {
    script += fmt::format("set label {} at {:.6g}, {:.6g} {} font \",11\"\n", tools::plot_text(name), time_s, 100 * error, where);
  };
  // From the merge alone (hollow) to response and merge together (filled); programs and the plain loop are one point.
  const auto add = [&](double merge_s, double whole_s, const RadianceError& e, const std::string& colour) {
    script += fmt::format("$line{} << EOD\n{:.6g} {:.6g}\n{:.6g} {:.6g}\nEOD\n", ++n_lines, merge_s, 100 * e.median, whole_s, 100 * e.median);
    lines += fmt::format(", $line{0} with lines lc rgb {1} lw 1.6, $line{0} every ::0::0 with points pt 6 ps 1.1 lw 1.6 lc rgb {1}"
                         ", $line{0} every ::1::1 with points pt 7 ps 1.1 lc rgb {1}", n_lines, colour);
  };
  const double total = ours.response.min_s + ours.noise.min_s + ours.merge.min_s;
  add(ours.merge.min_s, total, ours.estimated, "vermilion");
  label(std::sqrt(ours.merge.min_s * total), ours.estimated.median, "center offset 0, 0.9 textcolor rgb vermilion", "Lacquer");
  for (const PeerCase& p : r.peers) {
    if (!p.result.unavailable.empty()) continue;
    const double merge = p.result.whole.repeats ? p.result.whole.min_s : p.result.merge.min_s, whole = merge + p.result.response.min_s;
    const bool library = p.result.response.repeats > 0, plain = !library && !p.result.whole.repeats;
    add(merge, whole, p.error, library ? "blue" : "black");
    label(std::sqrt(merge * whole), p.error.median,
          library ? "center offset 0, 0.9 textcolor rgb blue" : plain ? "center offset 0, -1 textcolor rgb black" : "left offset 1.2, 0 textcolor rgb black",
          p.result.name);
  }
  return script + fmt::format("reference = {:.6g}\nread = {:.6g}\n", 100 * ours.reference.median, r.memory.read_16bit.min_s) +
         R"plot(set logscale xy
set xlabel "time, s: merge (hollow), response and merge or whole process (filled)"
set ylabel "median error of radiance, %"
set key off
set xrange [read / 2:100]
set yrange [reference * 0.75:5]
set ytics (0.5, 0.6, 0.7, 0.8, 1, 1.5, 2, 3, 4, 6, 10)
set label "all known: reference" at graph 0.99, first reference * 0.96 right textcolor rgb grey font ",11"
set arrow from read, graph 0 to read, graph 1 nohead lc rgb grey dt 2
set label "reading the stack once" at read * 1.1, graph 0.97 textcolor rgb grey font ",11"
plot reference lc rgb grey dt 2)plot" + lines + "\n";
}

}  // namespace lacquer::bench
