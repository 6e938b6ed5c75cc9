#pragma once

#include <algorithm>
#include <cstdint>
#include <random>
#include <string>

namespace lacquer::test {

/// Some bytes overwritten, a stretch cut out, doubled or appended; mostly small changes, mostly among the first `hot` bytes. The same for
/// the same generator on every machine.
inline std::string damaged(std::string s, std::mt19937& rng, std::size_t hot) {
  const auto position = [&] { return rng() % (rng() % 4 != 0 ? std::min(hot, s.size()) : s.size()); };
  const std::uint32_t interesting[] = {0, 1, 0x7f, 0x80, 0xff};
  for (std::size_t k = 0, n = 1 + rng() % 2; k < n && !s.empty(); ++k) {
    switch (rng() % 8) {
      case 0: s.erase(position(), 1 + rng() % 16); break;
      case 1: {
        const std::size_t from = position(), to = position();
        s.insert(to, s.substr(from, rng() % 32));
        break;
      }
      case 2: s.resize(position()); break;
      case 3:  // a whole number at its limits
        for (std::size_t at = position(), end = std::min(at + (rng() % 2 ? 4 : 8), s.size()); at < end; ++at) s[at] = static_cast<char>(0xff);
        break;
      case 4: s[position()] = static_cast<char>(interesting[rng() % 5]); break;
      default: s[position()] = static_cast<char>(rng()); break;
    }
  }
  return s;
}

}  // namespace lacquer::test
