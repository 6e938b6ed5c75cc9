#include "libbrdf/brdf_explorer.h"

#include <fmt/format.h>

#include "libbrdf/error.h"

#include <map>
#include <sstream>

#include "libbrdf/file_error.h"
#include "libbrdf/files.h"

namespace lacquer::brdf {

namespace {

constexpr const char* shader_head = R"(
const float PI = 3.14159265358979323846;

// Beckmann Cook-Torrance lobe of Guenther et al. 2005, Eq. 1, for ks = 1, in 1/sr, without the cosine.
float lobe(float m, float r, float NdotL, float NdotV, float NdotH, float VdotH)
{
    float c2 = NdotH * NdotH;
    float D = exp(-(1.0 - c2) / (c2 * m * m)) / (m * m * c2 * c2);
    float F = r + (1.0 - r) * pow(1.0 - VdotH, 5.0);
    float G = min(1.0, min(2.0 * NdotH * NdotV / VdotH, 2.0 * NdotH * NdotL / VdotH));
    return F * D * G / (PI * NdotL * NdotV);
}

vec3 BRDF( vec3 L, vec3 V, vec3 N, vec3 X, vec3 Y )
{
    float NdotL = dot(N, L);
    float NdotV = dot(N, V);
    if (NdotL <= 0.0 || NdotV <= 0.0) return vec3(0.0);
    vec3 H = normalize(L + V);
    float NdotH = dot(N, H);
    float VdotH = dot(V, H);
    vec3 f = kd / PI;
)";

/// `color` gives a slider in [0, 1] per channel; larger values are typed. `float NAME MIN MAX DEFAULT`.
std::string color_line(const std::string& name, const glm::dvec3& c) { return fmt::format("color {} {} {} {}\n", name, c.r, c.g, c.b); }

}  // namespace

std::string brdf_explorer_text(const CookTorrance& model, const std::string& comment) {
  for (const auto& lobe : model.lobes)
    if (lobe.distribution != Distribution::beckmann || lobe.fresnel != Fresnel::schlick)
      throw Error(ErrorCode::input, ".brdf: its shader has Beckmann's distribution and Schlick's reflectance only; this model has GGX or a dielectric lobe, convert to .bsdf");
  std::string text = "analytic\n\n# " + printable(comment, 4000) + "\n\n::begin parameters\n" + color_line("kd", model.kd);
  for (std::size_t i = 0; i < model.lobes.size(); ++i) {
    text += color_line(fmt::format("ks{}", i + 1), model.lobes[i].ks);
    text += fmt::format("float m{0} 0.001 1.0 {1}\nfloat r{0} 0.0 1.0 {2}\n", i + 1, model.lobes[i].m, model.lobes[i].r);
  }
  text += std::string("::end parameters\n\n::begin shader\n") + shader_head;
  for (std::size_t i = 1; i <= model.lobes.size(); ++i)
    text += fmt::format("    f += ks{0} * lobe(m{0}, r{0}, NdotL, NdotV, NdotH, VdotH);\n", i);
  return text + "    return f;\n}\n\n::end shader\n";
}

CookTorrance brdf_explorer_model(const std::string& text, const std::string& name_for_errors) {
  std::istringstream lines(text);
  std::map<std::string, std::string> colors, numbers;
  std::string line;
  bool inside = false;
  while (std::getline(lines, line)) {
    if (line == "::begin parameters") inside = true;
    if (line == "::end parameters") break;
    if (!inside) continue;
    std::istringstream fields(line);
    std::string type, name, a, b, c;
    fields >> type >> name >> a >> b >> c;
    if (type == "color") colors[name] = fmt::format("[{}, {}, {}]", a, b, c);
    if (type == "float") numbers[name] = c;
  }
  if (!colors.count("kd")) fail_file(name_for_errors, "expected parameters written by Lacquer: color kd");
  // The checks are those of the model's own JSON.
  std::string lobes;
  for (int i = 1; colors.count(fmt::format("ks{}", i)); ++i)
    lobes += fmt::format("{}{{\"ks\": {}, \"m\": {}, \"r\": {}}}", lobes.empty() ? "" : ", ", colors[fmt::format("ks{}", i)],
                         numbers[fmt::format("m{}", i)], numbers[fmt::format("r{}", i)]);
  return model_from_json(fmt::format("{{\"kd\": {}, \"lobes\": [{}]}}", colors["kd"], lobes), name_for_errors);
}

}  // namespace lacquer::brdf
