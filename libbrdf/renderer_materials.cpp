#include "libbrdf/renderer_materials.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "libbrdf/cook_torrance.h"
#include "libbrdf/file_error.h"
#include "libbrdf/files.h"

namespace lacquer::brdf {

namespace {

constexpr double pi = std::numbers::pi;

double ggx(const HalfAngleCosines<double>& c, double alpha) {
  const double nh2 = c.n_dot_h * c.n_dot_h, a2 = alpha * alpha;
  // sin^2 from the tangent: 1 - cos^2 has no digits left at the peak of a clear coat.
  const double d = nh2 * (a2 + c.tan2_theta_h);
  return a2 / (pi * d * d);
}

double smith_root(double cosine, double alpha) { return std::sqrt(alpha * alpha + (1 - alpha * alpha) * cosine * cosine); }

glm::dvec3 schlick(const glm::dvec3& f0, double cosine) { return f0 + (glm::dvec3(1.0) - f0) * schlick_weight(cosine); }

/// Unpolarised reflectance of a smooth dielectric.
double dielectric(double cosine, double ior) {
  const double g2 = ior * ior - 1 + cosine * cosine, g = std::sqrt(g2);
  const double a = (g - cosine) / (g + cosine), b = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1);
  return 0.5 * a * a * (1 + b * b);
}

/// F82-tint of Kutz, Hasan and Edmondson 2021: Schlick with a colour at 82 degrees, cosine 1/7.
glm::dvec3 f82_tint(const glm::dvec3& f0, const glm::dvec3& tint, double cosine) {
  constexpr double bar = 1.0 / 7;
  const double x = 1 - bar, x6 = x * x * x * x * x * x, y = 1 - cosine, y6 = y * y * y * y * y * y;
  const glm::dvec3 drop = schlick(f0, bar) * (glm::dvec3(1.0) - tint) / (bar * x6);
  return schlick(f0, cosine) - drop * (cosine * y6);
}

std::string numbers(const glm::dvec3& c, const char* separator) { return fmt::format("{:.6g}{}{:.6g}{}{:.6g}", c.r, separator, c.g, separator, c.b); }

std::string one_line(const std::string& text) { return printable(text, 4000); }

}  // namespace

glm::dvec3 LuxCoreCarPaint::value(const Directions& d) const {
  const auto c = half_angle_cosines(d);
  glm::dvec3 f = kd / pi;
  for (const Lobe& lobe : lobes) {
    const double roughness = lobe.m * lobe.m;
    // G / (cos cos), each factor cos / (cos (1 - roughness) + roughness).
    const double g = 1 / ((c.n_dot_i * (1 - roughness) + roughness) * (c.n_dot_o * (1 - roughness) + roughness));
    f += lobe.ks * (ggx(c, lobe.m) * g / 4 * (lobe.r + (1 - lobe.r) * schlick_weight(c.i_dot_h)));
  }
  return f;
}

std::string LuxCoreCarPaint::text(const std::string& name, const std::string& comment) const {
  const std::string prefix = "scene.materials." + name + ".";
  std::string text = fmt::format("# {}\n{}type = \"carpaint\"\n{}kd = {}\n", one_line(comment), prefix, prefix, numbers(kd, " "));
  for (std::size_t i = 0; i < lobes.size(); ++i)
    text += fmt::format("{0}ks{1} = {2}\n{0}m{1} = {3:.6g}\n{0}r{1} = {4:.6g}\n", prefix, i + 1, numbers(lobes[i].ks, " "), lobes[i].m, lobes[i].r);
  return text + prefix + "ka = 0 0 0\n" + prefix + "d = 0\n";
}

glm::dvec3 GltfClearcoat::value(const Directions& d) const {
  const auto c = half_angle_cosines(d);
  const auto specular = [&](double r) {
    const double alpha = r * r;
    return ggx(c, alpha) / ((c.n_dot_i + smith_root(c.n_dot_i, alpha)) * (c.n_dot_o + smith_root(c.n_dot_o, alpha)));
  };
  const glm::dvec3 f = schlick(glm::dvec3(0.04 * (1 - metallic)) + base_color * metallic, c.i_dot_h);
  const glm::dvec3 base = (glm::dvec3(1.0) - f) * base_color * ((1 - metallic) / pi) + f * specular(roughness);
  const double coat = clearcoat * (0.04 + 0.96 * schlick_weight(c.n_dot_o));
  return base * (1 - coat) + glm::dvec3(coat * specular(clearcoat_roughness));
}

std::string GltfClearcoat::text(const std::string& name, const std::string& comment) const {
  const auto rounded = [](double x) { return std::stod(fmt::format("{:.6g}", x)); };
  nlohmann::ordered_json material;
  material["name"] = name;
  material["pbrMetallicRoughness"] = {{"baseColorFactor", {rounded(base_color.r), rounded(base_color.g), rounded(base_color.b), 1.0}},
                                      {"metallicFactor", rounded(metallic)},
                                      {"roughnessFactor", rounded(roughness)}};
  material["extensions"]["KHR_materials_clearcoat"] = {{"clearcoatFactor", rounded(clearcoat)}, {"clearcoatRoughnessFactor", rounded(clearcoat_roughness)}};
  material["extras"]["description"] = one_line(comment);
  nlohmann::ordered_json gltf;
  gltf["asset"] = {{"version", "2.0"}, {"generator", std::string("lacquer ") + version()}};
  gltf["extensionsUsed"] = {"KHR_materials_clearcoat"};
  gltf["materials"] = nlohmann::ordered_json::array({material});
  return gltf.dump(2) + "\n";
}

glm::dvec3 OpenPbr::value(const Directions& d) const {
  const auto c = half_angle_cosines(d);
  const auto specular = [&](double roughness) {
    const double alpha = roughness * roughness;
    return ggx(c, alpha) / (2 * (c.n_dot_i * smith_root(c.n_dot_o, alpha) + c.n_dot_o * smith_root(c.n_dot_i, alpha)));
  };
  const glm::dvec3 metal = f82_tint(base_color, specular_color, c.i_dot_h) * specular(specular_roughness);
  const glm::dvec3 base = metal * base_metalness + base_color * ((1 - base_metalness) / pi);
  return base * (1 - coat_weight * dielectric(c.n_dot_o, coat_ior)) +
         glm::dvec3(coat_weight * dielectric(c.i_dot_h, coat_ior) * specular(coat_roughness));
}

std::string OpenPbr::text(const std::string& name, const std::string& comment) const {
  std::string safe = one_line(comment);
  for (auto at = safe.find("--"); at != std::string::npos; at = safe.find("--")) safe.replace(at, 2, "__");  // ends a comment in XML
  const auto input = [](const char* key, const char* type, const std::string& value) {
    return fmt::format("    <input name=\"{}\" type=\"{}\" value=\"{}\" />\n", key, type, value);
  };
  const auto number = [&](const char* key, double x) { return input(key, "float", fmt::format("{:.6g}", x)); };
  return fmt::format("<?xml version=\"1.0\"?>\n<!-- {} -->\n<materialx version=\"1.39\" colorspace=\"lin_rec709\">\n"
                     "  <open_pbr_surface name=\"{}_shader\" type=\"surfaceshader\">\n",
                     safe, name) +
         input("base_color", "color3", numbers(base_color, ", ")) + number("base_metalness", base_metalness) +
         input("specular_color", "color3", numbers(specular_color, ", ")) + number("specular_roughness", specular_roughness) +
         number("specular_ior", coat_ior) + number("coat_weight", coat_weight) + number("coat_roughness", coat_roughness) +
         number("coat_ior", coat_ior) + number("coat_darkening", 0) + "  </open_pbr_surface>\n" +
         fmt::format("  <surfacematerial name=\"{0}\" type=\"material\">\n"
                     "    <input name=\"surfaceshader\" type=\"surfaceshader\" nodename=\"{0}_shader\" />\n  </surfacematerial>\n</materialx>\n",
                     name);
}

}  // namespace lacquer::brdf
