#pragma once

#include <algorithm>
#include <filesystem>
#include <string>

#include "libbrdf/error.h"

/// Shared by the readers and writers of this folder, not part of the library's interface.
namespace lacquer::brdf {

/// Throws Error{file} "FILE: what" on one line, whatever control characters a foreign text brought along.
[[noreturn]] inline void fail_file(const std::filesystem::path& file, const std::string& what) {
  std::string text = file.string() + ": " + what;
  std::replace_if(text.begin(), text.end(), [](unsigned char c) { return c < 0x20 || c == 0x7f; }, ' ');
  throw Error(ErrorCode::file, text);
}

/// Foreign text for people and for JSON: printable ASCII, everything else as '?', at most `max_length` characters.
inline std::string printable(std::string text, std::size_t max_length = 200) {
  if (text.size() > max_length) text.resize(max_length);
  std::replace_if(text.begin(), text.end(), [](unsigned char c) { return c < 0x20 || c > 0x7e; }, '?');
  return text;
}

}  // namespace lacquer::brdf
