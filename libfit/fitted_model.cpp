#include "libfit/fitted_model.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>
#include <random>
#include <string_view>

#include "libbrdf/file_error.h"
#include "libbrdf/files.h"
#include "libfit/parameters.h"
#include "libfit/uncertainty.h"

namespace lacquer::fit {

namespace {

constexpr std::uint64_t max_bytes = 64u << 20;
constexpr std::size_t max_parameters = 3 + 5 * max_lobes;

/// Where a parameter of this name ("kd.r", "ks2.g", "ks3", "m1", "r2", "kd.y") sits in the model: pointers to 1 number or to 3.
std::vector<double*> places(brdf::CookTorrance& model, std::string_view name) {
  const std::size_t dot = name.find('.');
  const std::string_view stem = name.substr(0, dot), channel = dot == std::string_view::npos ? "" : name.substr(dot + 1);
  const auto colour = [&](glm::dvec3& c) -> std::vector<double*> {
    if (channel.empty() || channel == "y") return {&c.x, &c.y, &c.z};
    const std::size_t i = std::string_view("rgb").find(channel);
    return channel.size() == 1 && i < 3 ? std::vector<double*>{&c[static_cast<int>(i)]} : std::vector<double*>{};
  };
  if (stem == "kd") return colour(model.kd);
  const std::size_t digits = stem.find_first_of("0123456789");
  if (digits == std::string_view::npos) return {};
  std::size_t lobe = 0;
  const auto [end, status] = std::from_chars(stem.data() + digits, stem.data() + stem.size(), lobe);
  if (status != std::errc{} || end != stem.data() + stem.size() || lobe < 1 || lobe > model.lobes.size()) return {};
  auto& of = model.lobes[lobe - 1];
  const std::string_view kind = stem.substr(0, digits);
  if (kind == "ks") return colour(of.ks);
  if (kind == "m" && channel.empty()) return {&of.m};
  if (kind == "r" && channel.empty()) return {&of.r};
  return {};
}

brdf::CookTorrance with(const brdf::CookTorrance& model, const std::string& name, double value) {
  brdf::CookTorrance changed = model;
  for (double* place : places(changed, name)) *place = value;
  return changed;
}

/// d f / d parameter by a central difference; one-sided at a bound.
glm::dvec3 derivative(const FittedModel& fit, const Parameter& p, const brdf::HalfAngleCosines<double>& cosines) {
  const bool shape = p.name[0] == 'm' || p.name[0] == 'r';
  const double step = 1e-5 * std::max(std::abs(p.value), 1e-3);
  const double high = shape ? std::min(p.value + step, p.name[0] == 'm' ? 1.0 : 0.99) : p.value + step, low = std::max(p.value - step, 0.0);
  if (!(high > low)) return glm::dvec3(0);
  return (with(fit.model, p.name, high).value(cosines) - with(fit.model, p.name, low).value(cosines)) / (high - low);
}

}  // namespace

FittedModel read_fit(const std::filesystem::path& file) {
  const std::string name = file.string(), text = brdf::read_text(file, max_bytes);
  FittedModel fit{.model = brdf::model_from_json(text, name), .parameters = {}, .covariance = {}};
  const nlohmann::json j = nlohmann::json::parse(text, nullptr, false);
  const auto fail = [&](const std::string& what) { brdf::fail_file(name, what); };
  const auto parameters = j.find("parameters"), covariance = j.find("covariance");
  if (parameters == j.end() || covariance == j.end() || !parameters->is_array() || !covariance->is_array())
    fail("parameters, covariance: expected those of lacquer fit; a model alone has no errors");
  const std::size_t n = parameters->size();
  if (n > max_parameters || covariance->size() != n)
    fail(fmt::format("covariance: expected {} rows, at most {}, got {}", n, max_parameters, covariance->size()));
  for (std::size_t i = 0; i < n; ++i) {
    const auto& p = (*parameters)[i];
    const std::string field = fmt::format("parameters[{}]", i);
    if (!p.is_object() || !p.contains("name") || !p["name"].is_string() || !p.contains("value") || !p["value"].is_number() ||
        !p.contains("sigma") || !p["sigma"].is_number())
      fail(field + ": expected name, value and sigma");
    fit.parameters.push_back({.name = p["name"], .value = p["value"], .sigma = p["sigma"]});
    if (places(fit.model, fit.parameters.back().name).empty())
      fail(fmt::format("{}.name: the model has no parameter '{}'", field, brdf::printable(fit.parameters.back().name, 40)));
    const auto& row = (*covariance)[i];
    if (!row.is_array() || row.size() != n) fail(fmt::format("covariance[{}]: expected {} numbers", i, n));
    for (const auto& entry : row) {
      if (!entry.is_number()) fail(fmt::format("covariance[{}]: expected {} numbers", i, n));
      fit.covariance.push_back(entry);
    }
  }
  return fit;
}

glm::dvec3 value_sigma(const FittedModel& fit, const brdf::HalfAngleCosines<double>& cosines) {
  const std::size_t n = fit.parameters.size();
  std::vector<glm::dvec3> gradient;
  for (const Parameter& p : fit.parameters) gradient.push_back(derivative(fit, p, cosines));
  glm::dvec3 variance(0);
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j) variance += fit.covariance[i * n + j] * gradient[i] * gradient[j];
  return {std::sqrt(std::max(0.0, variance.x)), std::sqrt(std::max(0.0, variance.y)), std::sqrt(std::max(0.0, variance.z))};
}

std::vector<brdf::CookTorrance> draw_models(const FittedModel& fit, int count) {
  const int n = static_cast<int>(fit.parameters.size());
  // Of correlations, so that parameters of very different size keep their digits.
  std::vector<double> correlation(fit.covariance.size());
  for (int i = 0; i < n; ++i)
    for (int j = 0; j < n; ++j) {
      const double sigmas = fit.parameters[i].sigma * fit.parameters[j].sigma;
      correlation[i * n + j] = sigmas > 0 ? fit.covariance[i * n + j] / sigmas : 0;
    }
  const Eigensystem eigen = symmetric_eigensystem(correlation, n);
  std::mt19937_64 generator(1);
  // Not std::normal_distribution, whose values differ between libraries: Box and Muller 1958.
  const auto uniform = [&] { return (static_cast<double>(generator() >> 11) + 0.5) * 0x1p-53; };
  std::vector<brdf::CookTorrance> models;
  for (int k = 0; k < count; ++k) {
    std::vector<double> offset(static_cast<std::size_t>(n));
    for (int e = 0; e < n; ++e) {
      const double normal = std::sqrt(-2 * std::log(uniform())) * std::cos(2 * std::numbers::pi * uniform());
      for (int i = 0; i < n; ++i) offset[i] += std::sqrt(std::max(0.0, eigen.values[e])) * eigen.vectors[e * n + i] * normal;
    }
    brdf::CookTorrance model = fit.model;
    for (int i = 0; i < n; ++i) {
      const Parameter& p = fit.parameters[i];
      double value = std::max(0.0, p.value + p.sigma * offset[i]);
      if (p.name[0] == 'm') value = std::clamp(value, 1e-4, 1.0);
      if (p.name[0] == 'r') value = std::min(value, 0.99);
      if (p.sigma > 0) model = with(model, p.name, value);
    }
    models.push_back(std::move(model));
  }
  return models;
}

}  // namespace lacquer::fit
