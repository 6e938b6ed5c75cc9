#include <nlohmann/json.hpp>

#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libfit/fit.h"

namespace lacquer::fit {

namespace {

using Json = nlohmann::ordered_json;

Json colour(const glm::dvec3& c) { return {c.x, c.y, c.z}; }

void add_model(const brdf::CookTorrance& model, Json& j) {
  j["kd"] = colour(model.kd);
  j["lobes"] = Json::array();
  for (const auto& lobe : model.lobes) {
    Json& to = j["lobes"].emplace_back(Json{{"ks", colour(lobe.ks)}, {"m", lobe.m}, {"r", lobe.r}});
    if (lobe.distribution == brdf::Distribution::ggx) to["distribution"] = "ggx";
    if (lobe.fresnel == brdf::Fresnel::dielectric) to["fresnel"] = "dielectric";
  }
}

Json parameters(const FitResult& fit) {
  Json list = Json::array();
  for (const Parameter& p : fit.parameters) {
    Json& to = list.emplace_back(Json{{"name", p.name},
                                      {"value", p.value},
                                      {"sigma", p.sigma},
                                      {"at_bound", p.at_bound},
                                      {"determined", p.determined}});
    if (p.calibration_sigma > 0) to["calibration_sigma"] = p.calibration_sigma;
    if (p.profile) {
      to["profile_68"] = {p.profile->low68, p.profile->high68};
      to["profile_95"] = {p.profile->low95, p.profile->high95};
    }
  }
  return list;
}

/// Rows in the order of "parameters"; `scaled`: by the standard errors, i.e. correlations.
Json covariance(const FitResult& fit, bool scaled) {
  Json rows = Json::array();
  const std::size_t n = fit.parameters.size();
  for (std::size_t i = 0; i < n; ++i) {
    Json row = Json::array();
    for (std::size_t j = 0; j < n; ++j) {
      const double sigmas = fit.parameters[i].sigma * fit.parameters[j].sigma;
      row.push_back(!scaled ? fit.covariance[i * n + j] : i == j && sigmas > 0 ? 1.0 : sigmas > 0 ? fit.covariance[i * n + j] / sigmas : 0.0);
    }
    rows.push_back(std::move(row));
  }
  return rows;
}

Json minima(const FitResult& fit) {
  Json list = Json::array();
  for (const Minimum& minimum : fit.minima) {
    Json j{{"cost", minimum.cost}};
    add_model(minimum.model, j);
    list.push_back(std::move(j));
  }
  return list;
}

Json candidates(const FitResult& fit) {
  Json list = Json::array();
  for (const Candidate& candidate : fit.candidates) {
    Json j{{"structure", candidate.structure},
           {"n_parameters", candidate.n_parameters},
           {"criterion", candidate.criterion},
           {"cost", candidate.cost},
           {"mean_abs_log", candidate.mean_abs_log}};
    if (candidate.evaluation_ns > 0) {
      j["evaluation_ns"] = candidate.evaluation_ns;
      j["pareto"] = candidate.pareto;
    }
    add_model(candidate.model, j);
    list.push_back(std::move(j));
  }
  return list;
}

Json errors(const FitResult& fit) {
  return {{"mean_abs_log", fit.mean_abs_log},
          {"rms_log", fit.rms_log},
          {"reduced_chi2", fit.reduced_chi2},
          {"overdispersion", fit.overdispersion},
          {"parameter_price", fit.parameter_price},
          {"shared_error", fit.shared_error},
          {"energy", fit.energy},
          {"n_cells", fit.n_cells},
          {"n_cells_available", fit.n_cells_available},
          {"n_residuals", fit.n_residuals},
          {"n_bounds", fit.n_bounds},
          {"converged", fit.converged},
          {"message", fit.message},
          {"left_out",
           {{"grazing", fit.left_out.grazing},
            {"not_positive", fit.left_out.not_positive},
            {"not_finite", fit.left_out.not_finite},
            {"not_measured", fit.left_out.not_measured}}}};
}

Json metrics(const FitMetrics& m) {
  const brdf::BrdfDifference& d = m.difference;
  const auto or_null = [](double x, std::size_t n) { return n ? Json(x) : Json(nullptr); };
  return {{"mean_abs_log", d.mean_abs_log},
          {"rms_log", d.rms_log},
          {"cosine_rms", d.cosine_rms},
          {"cube_root_rms", d.cube_root_rms},
          {"delta_e_2000_mean", or_null(d.delta_e_mean, d.n_pixels)},
          {"delta_e_2000_p95", or_null(d.delta_e_p95, d.n_pixels)},
          {"probe_delta_e_2000_mean", or_null(m.probe_delta_e_mean, m.probe_pixels)},
          {"probe_delta_e_2000_p95", or_null(m.probe_delta_e_p95, m.probe_pixels)},
          {"delta_e_2000_of_errors", m.delta_e_of_errors},
          {"n_directions", d.n_directions}};
}

Json options(const FitOptions& o) {
  return {{"n_lobes", o.n_lobes ? Json(*o.n_lobes) : Json(nullptr)},
          {"n_starts", o.n_starts},
          {"max_cells", o.max_cells},
          {"model_sigma", o.model_sigma},
          {"min_cosine", o.min_cosine},
          {"min_m", o.min_m},
          {"robust_scale", o.robust_scale},
          {"energy_weight", o.energy_weight},
          {"limit_groups", o.limit_groups},
          {"other_forms", o.other_forms},
          {"profile", o.profile},
          {"half_vector_sigma", o.half_vector_sigma},
          {"solver", o.ceres ? "ceres" : "own"},
          {"max_iterations", o.max_iterations}};
}

}  // namespace

std::string fit_to_json(const FitResult& fit, bool absolute_scale, const std::string& provenance_json) {
  Json j{{"version", 1},
         {"kind", "lacquer fit"},
         {"model", "Cook-Torrance, Guenther et al. 2005, Eq. 1"},
         {"unit", absolute_scale ? "1/sr" : "relative"},
         {"scale", absolute_scale ? "absolute" : "relative"},
         {"scale_sigma", fit.scale_sigma}};
  add_model(fit.model, j);
  j["parameters"] = parameters(fit);
  j["covariance"] = covariance(fit, false);
  j["correlation"] = covariance(fit, true);
  j["errors"] = errors(fit);
  if (fit.metrics) j["metrics"] = metrics(*fit.metrics);
  j["candidates"] = candidates(fit);
  j["minima"] = minima(fit);
  j["options"] = options(fit.options);
  try {
    j["provenance"] = Json::parse(provenance_json.empty() ? "{}" : provenance_json);
    return j.dump(1) + "\n";
  } catch (const nlohmann::json::exception& e) {
    throw Error(ErrorCode::input, std::string("fit provenance: expected JSON text: ") + e.what());
  }
}

void write_fit(const std::filesystem::path& file, const FitResult& fit, bool absolute_scale,
               const std::string& provenance_json) {
  brdf::write_text_atomically(file, fit_to_json(fit, absolute_scale, provenance_json));
}

}  // namespace lacquer::fit
