#include <fmt/format.h>

#include <array>
#include <cmath>
#include <nlohmann/json.hpp>

#include "libbrdf/file_error.h"
#include "libbrdf/files.h"

namespace lacquer::brdf {

namespace {

using Json = nlohmann::json;

constexpr std::uint64_t max_text_bytes = 64u << 20;
constexpr int max_depth = 64;       // a fit.json has 5
constexpr std::size_t max_lobes = 16;
constexpr double min_m = 1e-6;      // below, 1/m^2 overflows float; a hundred times narrower than any lobe a camera can see
constexpr double max_dielectric_r = 0.99;  // an index of refraction of 400: beyond any, and the formula stays finite
constexpr double max_color = 1e6;   // kd, ks: keeps f_r finite in float

/// Numbers of the file, with the name of the field in every complaint.
class ModelReader {
 public:
  explicit ModelReader(std::string name) : name_(std::move(name)) {}

  [[noreturn]] void fail(const std::string& field, const std::string& what) const { fail_file(name_, field + ": " + what); }

  const Json& member(const Json& object, const std::string& field, const char* key) const {
    const auto found = object.find(key);
    if (found == object.end()) fail(field.empty() ? key : field + "." + key, "is missing");
    return *found;
  }

  double number(const Json& value, const std::string& field, const std::string& expected) const {
    if (!value.is_number()) fail(field, fmt::format("expected {}, got {}", expected, value.type_name()));
    return value.get<double>();
  }

  glm::dvec3 color(const Json& value, const std::string& field) const {
    if (!value.is_array()) fail(field, fmt::format("expected 3 numbers [r, g, b], got {}", value.type_name()));
    if (value.size() != 3) fail(field, fmt::format("expected 3 numbers [r, g, b], got {}", value.size()));
    glm::dvec3 c;
    for (int i = 0; i < 3; ++i) {
      const std::string element = fmt::format("{}[{}]", field, i);
      c[i] = number(value[static_cast<std::size_t>(i)], element, "a number >= 0");
      if (!(c[i] >= 0)) fail(element, fmt::format("expected a number >= 0, got {}", c[i]));
      if (c[i] > max_color) fail(element, fmt::format("expected at most {}, got {}", max_color, c[i]));
    }
    return c;
  }

  CookTorrance::Lobe lobe(const Json& value, const std::string& field) const {
    if (!value.is_object()) fail(field, fmt::format("expected {{\"ks\", \"m\", \"r\"}}, got {}", value.type_name()));
    CookTorrance::Lobe lobe;
    lobe.ks = color(member(value, field, "ks"), field + ".ks");
    lobe.m = number(member(value, field, "m"), field + ".m", "a number in (0, 1]");
    if (!(lobe.m > 0 && lobe.m <= 1)) fail(field + ".m", fmt::format("expected a number in (0, 1], got {}", lobe.m));
    if (lobe.m < min_m) fail(field + ".m", fmt::format("expected at least {}, got {}", min_m, lobe.m));
    lobe.r = number(member(value, field, "r"), field + ".r", "a number in [0, 1]");
    if (!(lobe.r >= 0 && lobe.r <= 1)) fail(field + ".r", fmt::format("expected a number in [0, 1], got {}", lobe.r));
    lobe.distribution = choice<Distribution>(value, field, "distribution", {"beckmann", "ggx"});
    lobe.fresnel = choice<Fresnel>(value, field, "fresnel", {"schlick", "dielectric"});
    if (lobe.fresnel == Fresnel::dielectric && lobe.r > max_dielectric_r)
      fail(field + ".r", fmt::format("expected at most {} where fresnel is \"dielectric\", got {}", max_dielectric_r, lobe.r));
    return lobe;
  }

 private:
  /// Member `key`, which may be missing, as the enumerator of its name; the first one is the default.
  template <typename Enum>
  Enum choice(const Json& object, const std::string& field, const char* key, const std::array<const char*, 2>& names) const {
    const auto found = object.find(key);
    if (found == object.end()) return Enum{};
    for (std::size_t i = 0; i < names.size(); ++i)
      if (found->is_string() && *found == names[i]) return static_cast<Enum>(i);
    fail(fmt::format("{}.{}", field, key), fmt::format("expected \"{}\" or \"{}\", got {}", names[0], names[1], printable(found->dump(-1, ' ', true, Json::error_handler_t::replace), 40)));
  }

  std::string name_;
};

/// Parses only what belongs to the model; whatever else a fit.json carries is skipped without being kept in memory.
Json parse_model_keys(const std::string& text, const std::string& name) {
  const auto keep = [&](int depth, Json::parse_event_t event, const Json& parsed) {
    if (depth > max_depth) fail_file(name, fmt::format("is nested deeper than {} levels", max_depth));
    return !(event == Json::parse_event_t::key && depth == 1 && parsed != "kd" && parsed != "lobes");
  };
  try {
    return Json::parse(text, keep);
  } catch (const Json::exception& e) {
    // "[json.exception.parse_error.101] parse error at line 1, ...": the part in brackets tells a user nothing.
    const std::string what = e.what();
    const auto end = what.find("] ");
    fail_file(name, "is not valid JSON: " + (end == std::string::npos ? what : what.substr(end + 2)));
  }
}

std::string color_text(const glm::dvec3& c) { return fmt::format("[{}, {}, {}]", c.r, c.g, c.b); }

}  // namespace

CookTorrance model_from_json(const std::string& text, const std::string& name_for_errors) {
  if (text.size() > max_text_bytes)
    fail_file(name_for_errors, fmt::format("has {} bytes, expected at most {}", text.size(), max_text_bytes));
  const Json json = parse_model_keys(text, name_for_errors);
  const ModelReader reader(name_for_errors);
  if (!json.is_object())
    fail_file(name_for_errors, fmt::format("expected an object {{\"kd\", \"lobes\"}}, got {}", json.type_name()));

  CookTorrance model;
  model.kd = reader.color(reader.member(json, "", "kd"), "kd");
  const Json& lobes = reader.member(json, "", "lobes");
  if (!lobes.is_array()) reader.fail("lobes", fmt::format("expected an array of lobes, got {}", lobes.type_name()));
  if (lobes.size() > max_lobes) reader.fail("lobes", fmt::format("expected at most {} lobes, got {}", max_lobes, lobes.size()));
  for (std::size_t i = 0; i < lobes.size(); ++i) model.lobes.push_back(reader.lobe(lobes[i], fmt::format("lobes[{}]", i)));
  return model;
}

CookTorrance read_model(const std::filesystem::path& file) {
  return model_from_json(read_text(file, max_text_bytes), file.string());
}

std::string model_to_json(const CookTorrance& model) {
  std::string lobes;
  for (const auto& lobe : model.lobes)
    lobes += fmt::format("{}{{\"ks\": {}, \"m\": {}, \"r\": {}{}{}}}", lobes.empty() ? "" : ", ", color_text(lobe.ks), lobe.m, lobe.r,
                         lobe.distribution == Distribution::ggx ? ", \"distribution\": \"ggx\"" : "",
                         lobe.fresnel == Fresnel::dielectric ? ", \"fresnel\": \"dielectric\"" : "");
  return fmt::format("{{\"kd\": {}, \"lobes\": [{}]}}", color_text(model.kd), lobes);
}

}  // namespace lacquer::brdf
