#include "libacquire/toml_reader.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <sstream>
#include <toml.hpp>

#include "libacquire/nearest_name.h"
#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

constexpr std::size_t max_text_bytes = 4u << 20;
/// The parser recurses per level of nesting: a forged file must not exhaust the stack.
constexpr int max_nesting = 32;

/// Brackets and dotted keys of the text, counted roughly (strings are not told apart, which only makes the check stricter for brackets
/// in strings; no rig file comes near the limit).
bool too_nested(const std::string& text) {
  int brackets = 0, dots = 0;
  for (const char c : text) {
    if (c == '[' || c == '{') ++brackets;
    if (c == ']' || c == '}') brackets = std::max(0, brackets - 1);
    if (c == '.') ++dots;
    if (c == '=' || c == ',' || c == '\n') dots = 0;
    if (brackets > max_nesting || dots > max_nesting) return true;
  }
  return false;
}

/// TOML is UTF-8 by definition, and toml11 3.7 reads beyond its buffer when it reports a string that is not. First byte that is wrong, or npos.
std::size_t not_utf8(const std::string& text) {
  for (std::size_t i = 0; i < text.size();) {
    const auto byte = [&](std::size_t k) { return k < text.size() ? static_cast<unsigned char>(text[k]) : 0u; };
    const unsigned first = byte(i);
    const std::size_t length = first < 0x80 ? 1 : first >= 0xc2 && first < 0xe0 ? 2 : first >= 0xe0 && first < 0xf0 ? 3 : first >= 0xf0 && first < 0xf5 ? 4 : 0;
    if (length == 0) return i;
    for (std::size_t k = 1; k < length; ++k)
      if ((byte(i + k) & 0xc0) != 0x80) return i;
    const unsigned second = byte(i + 1);
    // Too long a code, a half of a surrogate pair, beyond U+10FFFF.
    if ((first == 0xe0 && second < 0xa0) || (first == 0xed && second >= 0xa0) || (first == 0xf0 && second < 0x90) || (first == 0xf4 && second >= 0x90)) return i;
    i += length;
  }
  return std::string::npos;
}

/// First line of the parser's message without its own decoration: "[error] toml::parse_key: text" becomes "text".
std::string plain_message(const std::string& what) {
  std::string line = what.substr(0, what.find('\n'));
  if (line.starts_with("[error] ")) line.erase(0, 8);
  if (line.starts_with("toml::")) line.erase(0, line.find(": ") == std::string::npos ? 0 : line.find(": ") + 2);
  for (char& c : line)
    if (static_cast<unsigned char>(c) < 0x20) c = ' ';
  return line.empty() ? "syntax error" : line;
}

std::string expected_range(Range range) {
  if (range.min_excluded) return fmt::format("a number above {:g} and at most {:g}", range.min, range.max);
  return fmt::format("a number from {:g} to {:g}", range.min, range.max);
}

std::string kind_of(const toml::value& v) {
  switch (v.type()) {
    case toml::value_t::boolean: return "true or false";
    case toml::value_t::integer:
    case toml::value_t::floating: return "a number";
    case toml::value_t::string: return "a string";
    case toml::value_t::array: return "a list";
    case toml::value_t::table: return "a table";
    default: return "a date or time";
  }
}

}  // namespace

struct TomlTable::Node {
  toml::value value;  // a table

  const toml::value* find(std::string_view key) const {
    const auto& table = value.as_table();
    const auto found = table.find(std::string(key));
    return found == table.end() ? nullptr : &found->second;
  }
};

TomlTable::TomlTable(std::shared_ptr<const Node> node, std::string name, std::string path)
    : node_(std::move(node)), name_(std::move(name)), path_(std::move(path)) {}

TomlTable TomlTable::parse(const std::string& text, const std::string& name, Keys known) {
  if (text.size() > max_text_bytes)
    throw Error(ErrorCode::file, fmt::format("{}: {} bytes; expected at most {}", name, text.size(), max_text_bytes));
  if (too_nested(text)) throw Error(ErrorCode::file, fmt::format("{}: nested deeper than {} levels", name, max_nesting));
  if (const std::size_t at = not_utf8(text); at != std::string::npos)
    throw Error(ErrorCode::file, fmt::format("{}:{}: not valid TOML: expected UTF-8", name, 1 + std::count(text.begin(), text.begin() + static_cast<std::ptrdiff_t>(at), '\n')));
  std::shared_ptr<const Node> node;
  try {
    std::istringstream stream(text);
    node = std::make_shared<const Node>(Node{toml::parse(stream, name)});
  } catch (const toml::exception& e) {
    throw Error(ErrorCode::file, fmt::format("{}:{}: not valid TOML: {}", name, e.location().line(), plain_message(e.what())));
  } catch (const std::exception& e) {
    throw Error(ErrorCode::file, fmt::format("{}: not valid TOML: {}", name, plain_message(e.what())));
  }
  TomlTable root(std::move(node), name, "");
  root.check_keys(known);
  return root;
}

void TomlTable::check_keys(Keys known) const {
  std::vector<std::string> unknown;
  for (const auto& [key, value] : node_->value.as_table())
    if (std::find(known.begin(), known.end(), key) == known.end()) unknown.push_back(key);
  if (unknown.empty()) return;
  const std::string& first = *std::min_element(unknown.begin(), unknown.end());  // tables are unordered
  const std::string where = path_.empty() ? "" : path_.ends_with(']') ? path_ + ": " : "[" + path_ + "]: ";
  throw Error(ErrorCode::file, fmt::format("{}: {}unknown key \"{}\"; did you mean \"{}\"?", name_, where, first.substr(0, 100),
                                           nearest_name(first, std::span(known.begin(), known.size()))));
}

std::string TomlTable::field(std::string_view key) const {
  if (key.empty()) return path_;
  return path_.empty() ? std::string(key) : path_ + "." + std::string(key);
}

void TomlTable::fail(std::string_view key, const std::string& what) const {
  const std::string where = field(key);
  throw Error(ErrorCode::file, name_ + ": " + (where.empty() ? "" : where + ": ") + what);
}

bool TomlTable::has(std::string_view key) const { return node_->find(key) != nullptr; }

bool TomlTable::is_table(std::string_view key) const {
  const toml::value* v = node_->find(key);
  return v && v->is_table();
}

bool TomlTable::is_array(std::string_view key) const {
  const toml::value* v = node_->find(key);
  return v && v->is_array();
}

bool TomlTable::is_string_array(std::string_view key) const {
  const toml::value* v = node_->find(key);
  return v && v->is_array() && !v->as_array().empty() && v->as_array().front().is_string();
}

std::optional<TomlTable> TomlTable::table(std::string_view key, Keys known) const {
  const toml::value* v = node_->find(key);
  if (!v) return std::nullopt;
  if (!v->is_table()) fail(key, "expected a table [" + field(key) + "], got " + kind_of(*v));
  TomlTable result(std::make_shared<const Node>(Node{*v}), name_, field(key));
  result.check_keys(known);
  return result;
}

std::vector<TomlTable> TomlTable::tables(std::string_view key, Keys known) const {
  std::vector<TomlTable> result;
  const toml::value* v = node_->find(key);
  if (!v) return result;
  if (!v->is_array()) fail(key, "expected tables [[" + field(key) + "]], got " + kind_of(*v));
  for (const toml::value& entry : v->as_array()) {
    const std::string path = fmt::format("{}[{}]", field(key), result.size());
    if (!entry.is_table()) throw Error(ErrorCode::file, fmt::format("{}: {}: expected a table, got {}", name_, path, kind_of(entry)));
    result.push_back(TomlTable(std::make_shared<const Node>(Node{entry}), name_, path));
    result.back().check_keys(known);
  }
  return result;
}

std::vector<std::pair<std::string, std::string>> TomlTable::string_table(std::string_view key) const {
  std::vector<std::pair<std::string, std::string>> result;
  const toml::value* v = node_->find(key);
  if (!v) return result;
  if (!v->is_table()) fail(key, "expected a table [" + field(key) + "], got " + kind_of(*v));
  for (const auto& [name, value] : v->as_table()) result.emplace_back(name, to_string(std::string(key) + "." + name, value));
  std::sort(result.begin(), result.end());
  return result;
}

template <typename Value>
double TomlTable::to_number(std::string_view key, const Value& value, Range range) const {
  double number = 0;
  if (value.is_integer())
    number = static_cast<double>(value.as_integer());
  else if (value.is_floating())
    number = value.as_floating();
  else
    fail(key, fmt::format("expected {}, got {}", expected_range(range), kind_of(value)));
  if (!std::isfinite(number) || !range.contains(number)) fail(key, fmt::format("expected {}, got {}", expected_range(range), number));
  return number;
}

template <typename Value>
std::string TomlTable::to_string(std::string_view key, const Value& value) const {
  if (!value.is_string()) fail(key, "expected a string, got " + kind_of(value));
  const std::string text = value.as_string().str;
  if (text.find('\0') != std::string::npos) fail(key, "expected a string without zero bytes");
  return text;
}

double TomlTable::number(std::string_view key, Range range) const {
  const toml::value* v = node_->find(key);
  if (!v) fail(key, "missing; expected " + expected_range(range));
  return to_number(key, *v, range);
}

double TomlTable::number(std::string_view key, Range range, double fallback) const {
  return has(key) ? number(key, range) : fallback;
}

std::int64_t TomlTable::integer(std::string_view key, std::int64_t min, std::int64_t max) const {
  const std::string expected = fmt::format("expected a whole number from {} to {}", min, max);
  const toml::value* v = node_->find(key);
  if (!v) fail(key, "missing; " + expected);
  if (v->is_floating()) fail(key, fmt::format("{}, got {}", expected, v->as_floating()));
  if (!v->is_integer()) fail(key, expected + ", got " + kind_of(*v));
  const std::int64_t number = v->as_integer();
  if (number < min || number > max) fail(key, fmt::format("{}, got {}", expected, number));
  return number;
}

std::int64_t TomlTable::integer(std::string_view key, std::int64_t min, std::int64_t max, std::int64_t fallback) const {
  return has(key) ? integer(key, min, max) : fallback;
}

std::string TomlTable::string(std::string_view key) const {
  const toml::value* v = node_->find(key);
  if (!v) fail(key, "missing; expected a string");
  return to_string(key, *v);
}

std::string TomlTable::string(std::string_view key, const std::string& fallback) const { return has(key) ? string(key) : fallback; }

bool TomlTable::boolean(std::string_view key, bool fallback) const {
  const toml::value* v = node_->find(key);
  if (!v) return fallback;
  if (!v->is_boolean()) fail(key, "expected true or false, got " + kind_of(*v));
  return v->as_boolean();
}

std::vector<double> TomlTable::numbers(std::string_view key, Range range, std::size_t min_count, std::size_t max_count) const {
  const std::string expected = min_count == max_count ? fmt::format("expected {} numbers", min_count)
                                                      : fmt::format("expected {} to {} numbers", min_count, max_count);
  const toml::value* v = node_->find(key);
  if (!v) fail(key, "missing; " + expected);
  if (!v->is_array()) fail(key, expected + ", got " + kind_of(*v));
  const auto& array = v->as_array();
  if (array.size() < min_count || array.size() > max_count) fail(key, fmt::format("{}, got {}", expected, array.size()));
  std::vector<double> result;
  for (std::size_t i = 0; i < array.size(); ++i) result.push_back(to_number(fmt::format("{}[{}]", key, i), array[i], range));
  return result;
}

glm::dvec2 TomlTable::vector2(std::string_view key, Range range) const {
  const auto v = numbers(key, range, 2, 2);
  return {v[0], v[1]};
}

glm::dvec3 TomlTable::vector3(std::string_view key, Range range) const {
  const auto v = numbers(key, range, 3, 3);
  return {v[0], v[1], v[2]};
}

glm::dvec3 TomlTable::vector3(std::string_view key, Range range, const glm::dvec3& fallback) const {
  return has(key) ? vector3(key, range) : fallback;
}

glm::dvec3 TomlTable::per_channel(std::string_view key, Range range, const glm::dvec3& fallback) const {
  if (!has(key)) return fallback;
  return is_array(key) ? vector3(key, range) : glm::dvec3(number(key, range));
}

std::vector<std::string> TomlTable::strings(std::string_view key, std::size_t max_count) const {
  const toml::value* v = node_->find(key);
  if (!v) fail(key, "missing; expected a list of strings");
  if (!v->is_array()) fail(key, "expected a list of strings, got " + kind_of(*v));
  const auto& array = v->as_array();
  if (array.empty() || array.size() > max_count) fail(key, fmt::format("expected 1 to {} strings, got {}", max_count, array.size()));
  std::vector<std::string> result;
  for (std::size_t i = 0; i < array.size(); ++i) result.push_back(to_string(fmt::format("{}[{}]", key, i), array[i]));
  return result;
}

std::size_t TomlTable::choice(std::string_view key, Keys choices, std::optional<std::size_t> fallback) const {
  if (!has(key) && fallback) return *fallback;
  std::string expected = "expected ";
  for (auto it = choices.begin(); it != choices.end(); ++it)
    expected += (it == choices.begin() ? "\"" : it + 1 == choices.end() ? " or \"" : ", \"") + std::string(*it) + "\"";
  if (!has(key)) fail(key, "missing; " + expected);
  const std::string text = string(key);
  const auto found = std::find(choices.begin(), choices.end(), text);
  if (found == choices.end()) fail(key, fmt::format("{}, got \"{}\"", expected, text));
  return static_cast<std::size_t>(found - choices.begin());
}

}  // namespace lacquer::acquire
