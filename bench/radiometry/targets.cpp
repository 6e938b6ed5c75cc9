#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "bench/radiometry/report.h"

namespace lacquer::bench {

namespace {

/// Decades below this fraction of full scale in the longest exposure (ten electrons) hold too little to judge a sigma by.
constexpr double darkest_decade = -3;

const PeerCase* peer(const Results& r, const std::string& name) {
  const auto p = std::find_if(r.peers.begin(), r.peers.end(), [&](const PeerCase& c) { return c.result.name == name; });
  return p != r.peers.end() && p->result.unavailable.empty() ? &*p : nullptr;
}

void add_radiance(const Results& r, std::vector<Target>& targets) {
  for (const int bits : {8, 12, 16}) {
    double worst = 0;
    std::string stack;
    for (const CaseResult& c : r.cases)
      if (const double ratio = c.estimated.median / c.reference.median; c.bits == bits && ratio > worst) worst = ratio, stack = c.curve;
    targets.push_back({fmt::format("radiance error, {} bit, estimated response: worst of the curves, of reference", bits), "<= 1.05",
                       fmt::format("{:.3f} ({})", worst, stack), worst <= 1.05, false});
  }
}

void add_response(const Results& r, std::vector<Target>& targets) {
  const PeerCase* opencv = peer(r, "OpenCV Robertson");
  for (const CaseResult& c : r.cases) {
    const double asked = c.bits == 8 ? (opencv ? std::min(opencv->response_error.rms, 0.0023) : 0.0023) : 0.001;
    targets.push_back({fmt::format("response rms, {}, {} bit", c.curve, c.bits), fmt::format("<= {:.3f} %", 100 * asked),
                       fmt::format("{:.3f} %", 100 * c.response_error.rms), c.response_error.rms <= asked, false});
    if (c.bits != 8)
      targets.push_back({fmt::format("response time, {}, {} bit", c.curve, c.bits), "<= 2 s", fmt::format("{:.2f} s", c.response.min_s),
                         c.response.min_s <= 2, true});
  }
  if (!opencv) return;
  const double faster = opencv->result.response.min_s / r.cases.front().response.min_s;
  targets.push_back({"response time, 8 bit, against OpenCV Robertson", ">= 20 x faster", fmt::format("{:.1f} x", faster), faster >= 20, true});
}

void add_merge(const Results& r, std::vector<Target>& targets) {
  const PeerCase* opencv = peer(r, "OpenCV Robertson");
  if (!opencv) return;
  const double faster = opencv->result.merge.min_s / r.cases.front().merge.min_s;
  targets.push_back({"merge time, 8 bit, against OpenCV Robertson", ">= 20 x faster", fmt::format("{:.1f} x", faster), faster >= 20, true});
}

void add_sigma(const Results& r, const std::string& which, std::vector<LevelStatistics> CaseResult::*levels, std::vector<Target>& targets) {
  double worst = 1;
  std::string where;
  for (const CaseResult& c : r.cases)
    for (const LevelStatistics& l : c.*levels)
      if (l.log10_signal >= darkest_decade && std::abs(l.standard_deviation - 1) >= std::abs(worst - 1))
        worst = l.standard_deviation, where = fmt::format("{}, {} bit, 1e{}", c.curve, c.bits, l.log10_signal);
  targets.push_back({"standardised errors, " + which + ": worst standard deviation from 1e-3 of full scale up", "0.97 .. 1.03",
                     fmt::format("{:.3f} ({})", worst, where), std::abs(worst - 1) <= 0.03, false});
}

}  // namespace

std::vector<Target> targets_of(const Results& r) {
  std::vector<Target> targets;
  add_radiance(r, targets);
  add_response(r, targets);
  add_merge(r, targets);
  add_sigma(r, "known response and noise", &CaseResult::levels_known, targets);
  add_sigma(r, "estimated response and noise", &CaseResult::levels_estimated, targets);
  if (r.memorial)
    targets.push_back({"memorial, log2 correlation with memorial.hdr", fmt::format(">= {:.5f} (OpenCV)", r.memorial->opencv.correlation),
                       fmt::format("{:.5f}", r.memorial->ours.correlation), r.memorial->ours.correlation >= r.memorial->opencv.correlation, false});
  return targets;
}

}  // namespace lacquer::bench
