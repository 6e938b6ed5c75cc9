#include "bench/chain/settings.h"

#include <fmt/format.h>

#include <cmath>
#include <stdexcept>

namespace lacquer::bench {

namespace {

Setting exposures(int n) { return {"exposures per view", std::to_string(n), static_cast<double>(n), {{"count = 8", fmt::format("count = {}", n)}}, {}, true}; }

Setting lights(int step_deg) {
  const int n = 180 / step_deg + 1;
  return {"lights per half turn", std::to_string(n), static_cast<double>(n), {{"step = 3", fmt::format("step = {}", step_deg)}}, {}, true};
}

/// The same field of view.
Setting image_size(int width) {
  const int height = width * 3 / 4;
  return {"image size", fmt::format("{} x {}", width, height), static_cast<double>(width) * height,
          {{"width_px = 480", fmt::format("width_px = {}", width)},
           {"height_px = 360", fmt::format("height_px = {}", height)},
           {"focal_length_px = 3055", fmt::format("focal_length_px = {}", 3055.0 * width / 480)}},
          {},
          true};
}

/// The same electrons on another converter.
Setting bits(int n) {
  const double factor = std::exp2(n - 12);
  return {"bits", std::to_string(n), 0,
          {{"bits = 12", fmt::format("bits = {}", n)},
           {"black_level_dn = 64", fmt::format("black_level_dn = {}", 64 * factor)},
           {"gain_e_per_dn = 4.2", fmt::format("gain_e_per_dn = {}", 4.2 / factor)}},
          {},
          true};
}

Setting cells(std::size_t n) {
  Setting s{"cells in the fit", std::to_string(n), static_cast<double>(n), {}, {}, false};
  s.fit.max_cells = n;
  return s;
}

Setting resolution(int coarse) {
  const int n = 90 / coarse;
  Setting s{"table resolution", fmt::format("{} x {} x {}", n, n, 2 * n), static_cast<double>(n), {}, {}, false};
  s.coarse = coarse;
  return s;
}

Setting lobes(int n) {
  Setting s{"lobes", std::to_string(n), static_cast<double>(n), {}, {}, false};
  s.fit.n_lobes = n;
  return s;
}

}  // namespace

std::vector<Setting> settings(bool few) {
  std::vector<Setting> list{{"base", "61 lights, 8 exposures, 480 x 360, 12 bit", 0, {}, {}, true}, exposures(3), lights(9), image_size(240), bits(8), resolution(2), cells(10000), lobes(2)};
  if (few) return list;
  list.insert(list.end(), {exposures(2), exposures(5), lights(6), lights(18), image_size(120), image_size(360), bits(10), bits(14), resolution(3), resolution(5), cells(1000), cells(100000), lobes(1), lobes(3)});
  return list;
}

std::string edited(std::string text, const Setting& setting) {
  for (const auto& [from, to] : setting.edits) {
    const std::size_t at = text.find(from);
    if (at == std::string::npos || text.find(from, at + 1) != std::string::npos) throw std::logic_error(fmt::format("the rig file has \"{}\" not exactly once", from));
    text.replace(at, from.size(), to);
  }
  return text;
}

}  // namespace lacquer::bench
