#include "libacquire/tic/tic_current.h"

#include <array>

namespace lacquer::acquire {

namespace {

/// Codes 0..32 of a T500, milliamperes: its driver's reference voltage comes from a divider of 32 resistors.
constexpr std::array<int, 33> t500_ma{0,    1,    174,  343,  495,  634,  762,  880,  990,  1092, 1189, 1281, 1368, 1452, 1532, 1611, 1687,
                                      1762, 1835, 1909, 1982, 2056, 2131, 2207, 2285, 2366, 2451, 2540, 2634, 2734, 2843, 2962, 3093};

}  // namespace

std::optional<double> tic_current(const std::string& product, int code) {
  if (code < 0) return std::nullopt;
  if (product == "T500") return code < 33 ? std::optional(t500_ma[static_cast<std::size_t>(code)] * 1e-3) : std::nullopt;
  if (product == "36v4") return code <= 127 ? std::optional(code * 275.0 / 3840) : std::nullopt;
  const bool t249 = product == "T249", t834 = product == "T834";
  if (!t249 && !t834 && product != "T825" && product != "N825") return std::nullopt;
  if (code > (t249 ? 112 : t834 ? 108 : 124) || (code > 64 && code % 4 != 0) || (code > 32 && code % 2 != 0)) return std::nullopt;
  return code * (t249 ? 0.040 : 0.032);
}

std::optional<std::uint8_t> tic_current_code(const std::string& product, double amperes) {
  std::optional<std::uint8_t> best;
  for (int code = 1; code <= 127; ++code)
    if (const auto current = tic_current(product, code); current && *current <= amperes + 1e-9) best = static_cast<std::uint8_t>(code);
  return best;
}

}  // namespace lacquer::acquire
