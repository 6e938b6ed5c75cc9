#pragma once

#include <span>
#include <string>
#include <string_view>

namespace lacquer::acquire {

/// The one of `known` that takes the fewest changed, missing, added or swapped letters to become `name` (the first of equals); empty
/// if there is none. For messages: "did you mean".
std::string nearest_name(std::string_view name, std::span<const std::string_view> known);

}  // namespace lacquer::acquire
