#include "bench/radiometry/report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "tools/plot.h"

namespace lacquer::bench {

namespace {

std::string percent(double fraction, int digits = 3) { return fmt::format("{:.{}f} %", 100 * fraction, digits); }
std::string milliseconds(const Timing& t) { return t.repeats ? fmt::format("{:.1f} / {:.1f}", 1e3 * t.min_s, 1e3 * t.median_s) : ""; }
std::string seconds(const Timing& t) { return t.repeats ? fmt::format("{:.2f}", t.min_s) : ""; }

Table machine_table(const Results& r) {
  std::string versions;
  for (const std::string& v : r.versions) versions += (versions.empty() ? "" : ", ") + v;
  return {"machine", "Machine and stack",
          {{"what", "value"},
           {"machine", fmt::format("{}, {} cores", r.machine.cpu, r.machine.cores)},
           {"date, revision", r.date + ", " + r.revision},
           {"beside", versions},
           {"command", "`" + r.command + "`"},
           {"stack", fmt::format("{} exposures of {:g} to {:g} ms, {} x {} x 3 values", r.times.size(), 1e3 * r.times.front(),
                                 1e3 * r.times.back(), r.width, r.height)}}};
}

Table memory_table(const Results& r) {
  Table t{"memory", "What memory allows, all cores", {{"the whole stack", "ms, min / median", "GB/s"}}};
  const auto add = [&](const std::string& name, const Timing& time, double bytes) {
    t.rows.push_back({name, milliseconds(time), fmt::format("{:.1f}", bytes / time.min_s / 1e9)});
  };
  add("streaming read, 8-bit values", r.memory.read_8bit, r.memory.n_values);
  add("streaming read, 16-bit values", r.memory.read_16bit, 2 * r.memory.n_values);
  add("memcpy, 16-bit values (bytes copied)", r.memory.copy, 2 * r.memory.n_values);
  return t;
}

Table peers_table(const Results& r) {
  const CaseResult& ours = r.cases.front();
  Table t{"peers",
          fmt::format("8 bit, {}: error beside time", ours.curve),
          {{"method", "response s", "merge ms, min / median", "whole process s", "median error", "95 %", "of reference", "response rms",
            "clipped in all: lost"}}};
  const auto add = [&](const std::string& name, const std::string& response, const std::string& merge, const std::string& whole,
                       const RadianceError& e, const std::string& response_rms, const std::string& lost) {
    t.rows.push_back({name, response, merge, whole, percent(e.median), percent(e.percentile95, 2),
                      fmt::format("{:.3f}", e.median / ours.reference.median), response_rms, lost});
  };
  add("reference: all known", "", "", "", ours.reference, "", "");
  add("Lacquer, response and noise known", "", milliseconds(ours.merge_known), "", ours.known, "", percent(ours.known.clipped_below_bound, 0));
  add("Lacquer, response and noise estimated", fmt::format("{:.2f} + {:.2f}", ours.response.min_s, ours.noise.min_s),
      milliseconds(ours.merge), "", ours.estimated, percent(ours.response_error.rms), percent(ours.estimated.clipped_below_bound, 0));
  for (const PeerCase& p : r.peers)
    if (p.result.unavailable.empty())
      add(p.result.name, seconds(p.result.response), milliseconds(p.result.merge), seconds(p.result.whole), p.error,
          p.response_error.levels ? percent(p.response_error.rms) : "", percent(p.error.clipped_below_bound, 0));
    else
      t.rows.push_back({p.result.name, "", "", "", p.result.unavailable, "", "", "", ""});
  return t;
}

Table depths_table(const Results& r) {
  Table t{"depths",
          "Three curves at three bit depths",
          {{"stack", "reference", "known", "estimated", "of reference", "response rms", "largest", "response s", "noise s",
            "merge ms, min / median", "of 16-bit read"}}};
  for (const CaseResult& c : r.cases)
    t.rows.push_back({fmt::format("{}, {} bit", c.curve, c.bits), percent(c.reference.median), percent(c.known.median),
                      percent(c.estimated.median), fmt::format("{:.3f}", c.estimated.median / c.reference.median),
                      percent(c.response_error.rms), percent(c.response_error.largest, 2), seconds(c.response) + (c.converged ? "" : " (not converged)"),
                      seconds(c.noise), milliseconds(c.merge), fmt::format("{:.1f} x", c.merge.min_s / r.memory.read_16bit.min_s)});
  return t;
}

Table sigma_table(const Results& r, const std::string& name, const std::string& title, std::vector<LevelStatistics> CaseResult::*levels) {
  std::set<int> decades;
  for (const CaseResult& c : r.cases)
    for (const LevelStatistics& l : c.*levels) decades.insert(static_cast<int>(l.log10_signal));
  Table t{name, title, {{"stack"}}};
  for (const int d : decades) t.rows[0].push_back(fmt::format("1e{}", d));
  for (const CaseResult& c : r.cases) {
    std::vector<std::string> row{fmt::format("{}, {} bit", c.curve, c.bits)};
    for (const int d : decades) {
      const auto& all = c.*levels;
      const auto l = std::find_if(all.begin(), all.end(), [&](const LevelStatistics& s) { return static_cast<int>(s.log10_signal) == d; });
      row.push_back(l == all.end() ? "" : fmt::format("{:.3f} ({:+.2f})", l->standard_deviation, l->mean));
    }
    t.rows.push_back(row);
  }
  return t;
}

Table memorial_table(const Results& r) {
  Table t{"memorial", "Memorial church against memorial.hdr", {{"method", "log2 correlation", "difference, 5 % .. 95 %, stops", "seconds"}}};
  if (!r.memorial) {
    t.rows.push_back({"skipped: the photographs are not here (set LACQUER_SHARED_DATA)", "", "", ""});
    return t;
  }
  const auto add = [&](const std::string& name, const Agreement& a, const Timing& time) {
    t.rows.push_back({name, fmt::format("{:.5f}", a.correlation), fmt::format("{:+.3f} .. {:+.3f}", a.percentile5, a.percentile95),
                      fmt::format("{:.2f}", time.min_s)});
  };
  add("Lacquer", r.memorial->ours, r.memorial->ours_s);
  add("OpenCV Robertson", r.memorial->opencv, r.memorial->opencv_s);
  return t;
}

Table weights_table(const Results& r) {
  Table t{"weights", "Three sums instead of ideal weights: loss of standard deviation", {{"noise", "exposures", "decades of time", "median", "largest"}}};
  for (const WeightLoss& w : r.weights)
    t.rows.push_back({w.sensor, std::to_string(w.frames), fmt::format("{:g}", w.decades), percent(w.median), percent(w.largest)});
  return t;
}

Table compression_table(const Results& r) {
  Table t{"compression", "OpenEXR compressions of a merged view",
          {{"compression", "write s", "read s", "MB", "largest change of a radiance, sigmas"}}};
  for (const CompressionResult& c : r.compressions)
    t.rows.push_back({c.name, seconds(c.write), seconds(c.read), fmt::format("{:.1f}", c.megabytes),
                      !c.lossy ? "0" : std::isfinite(c.largest_change) ? fmt::format("{:.2g}", c.largest_change) : "infinite"});
  return t;
}

Table targets_table(const Results& r) {
  Table t{"targets", "Asked and found", {{"what", "asked", "found", ""}}};
  for (const Target& target : targets_of(r)) t.rows.push_back({target.what, target.asked, target.found, target.met ? "met" : "**missed**"});
  return t;
}

}  // namespace

std::vector<Table> tables_of(const Results& r) {
  return {machine_table(r),
          targets_table(r),
          peers_table(r),
          depths_table(r),
          sigma_table(r, "sigma-known", "Standardised errors, response and noise known: standard deviation (mean)", &CaseResult::levels_known),
          sigma_table(r, "sigma-estimated", "Standardised errors, response and noise estimated: standard deviation (mean)",
                      &CaseResult::levels_estimated),
          weights_table(r),
          memory_table(r),
          memorial_table(r),
          compression_table(r)};
}

}  // namespace lacquer::bench
