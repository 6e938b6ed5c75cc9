#pragma once

#include <cstdint>
#include <glm/vec2.hpp>
#include <glm/vec3.hpp>
#include <initializer_list>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace lacquer::acquire {

/// Numbers a field may have. The limits are generous: they catch wrong units and typing errors, not unusual rigs.
struct Range {
  double min = -1e9, max = 1e9;
  bool min_excluded = false;
  static Range at_least(double min, double max = 1e9) { return {min, max, false}; }
  static Range above(double min, double max = 1e9) { return {min, max, true}; }
  bool contains(double v) const { return (min_excluded ? v > min : v >= min) && v <= max; }
};

/// One table of a TOML file. Its keys are checked against `known` when it is opened; every value is checked when it is read.
/// Errors are Error{file} in one line: `rig.toml: lights[3].position_mm: expected 3 numbers, got 2`. Array indices count from 0.
class TomlTable {
 public:
  using Keys = std::initializer_list<std::string_view>;

  /// The whole document; `name` begins every message.
  static TomlTable parse(const std::string& text, const std::string& name, Keys known);

  bool has(std::string_view key) const;
  /// nullopt: not in the file.
  std::optional<TomlTable> table(std::string_view key, Keys known) const;
  /// [[key]] tables in file order; empty: not in the file.
  std::vector<TomlTable> tables(std::string_view key, Keys known) const;
  /// A table of strings with free keys, in the order of the keys.
  std::vector<std::pair<std::string, std::string>> string_table(std::string_view key) const;
  bool is_table(std::string_view key) const;
  bool is_array(std::string_view key) const;
  bool is_string_array(std::string_view key) const;

  // Without a fallback the key must be there.
  double number(std::string_view key, Range range) const;
  double number(std::string_view key, Range range, double fallback) const;
  std::int64_t integer(std::string_view key, std::int64_t min, std::int64_t max) const;
  std::int64_t integer(std::string_view key, std::int64_t min, std::int64_t max, std::int64_t fallback) const;
  std::string string(std::string_view key) const;
  std::string string(std::string_view key, const std::string& fallback) const;
  bool boolean(std::string_view key, bool fallback) const;
  glm::dvec2 vector2(std::string_view key, Range range) const;
  glm::dvec3 vector3(std::string_view key, Range range) const;
  glm::dvec3 vector3(std::string_view key, Range range, const glm::dvec3& fallback) const;
  /// One number for all channels, or three.
  glm::dvec3 per_channel(std::string_view key, Range range, const glm::dvec3& fallback) const;
  std::vector<double> numbers(std::string_view key, Range range, std::size_t min_count, std::size_t max_count) const;
  std::vector<std::string> strings(std::string_view key, std::size_t max_count) const;
  /// Index of the string in `choices`.
  std::size_t choice(std::string_view key, Keys choices, std::optional<std::size_t> fallback = std::nullopt) const;

  /// Throws Error{file}: "file: path.key: what"; an empty key means the table itself.
  [[noreturn]] void fail(std::string_view key, const std::string& what) const;

 private:
  struct Node;  // hides the TOML library
  TomlTable(std::shared_ptr<const Node> node, std::string name, std::string path);
  void check_keys(Keys known) const;
  std::string field(std::string_view key) const;
  template <typename Value>
  double to_number(std::string_view key, const Value& value, Range range) const;
  template <typename Value>
  std::string to_string(std::string_view key, const Value& value) const;

  std::shared_ptr<const Node> node_;
  std::string name_;  ///< of the file
  std::string path_;  ///< "" (document), "camera", "lights[3]", ...
};

}  // namespace lacquer::acquire
