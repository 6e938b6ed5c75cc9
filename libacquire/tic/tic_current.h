#pragma once

#include <cstdint>
#include <optional>
#include <string>

namespace lacquer::acquire {

/// Current limits of a Tic's motor are codes, and each product has its own (Pololu, Tic user's guide, "Set current limit").
/// Amperes of a code; nullopt: the product ("T825", "T834", "N825", "T249", "T500", "36v4") is unknown, or does not have this code.
std::optional<double> tic_current(const std::string& product, int code);

/// The code of the largest current that is not above `amperes`; nullopt: the product is unknown, or all of its currents are.
std::optional<std::uint8_t> tic_current_code(const std::string& product, double amperes);

}  // namespace lacquer::acquire
