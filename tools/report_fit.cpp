#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libfit/fit.h"
#include "tools/report_page.h"
#include "tools/summary.h"

namespace lacquer::tools {

namespace {

using Json = nlohmann::ordered_json;

/// Calls `use` with the JSON of a fit.json; what it lacks is Error{file}. A bare model, {"kd", "lobes"}, has no "parameters".
template <typename Use>
auto with_fit_json(const std::filesystem::path& file, const Use& use) {
  try {
    return use(Json::parse(brdf::read_text(file)));
  } catch (const nlohmann::json::exception& e) {
    throw Error(ErrorCode::file, fmt::format("{}: expected what lacquer fit writes: {}", file.string(), e.what()));
  }
}

fit::FitResult parameters_of(const Json& j, const std::filesystem::path& file) {
  fit::FitResult fit;
  fit.model = brdf::read_model(file);
  for (const Json& p : j.at("parameters")) {
    fit.parameters.push_back({.name = p.at("name").get<std::string>(), .value = p.at("value").get<double>(), .sigma = p.at("sigma").get<double>(),
                              .at_bound = p.at("at_bound").get<bool>(), .determined = p.at("determined").get<bool>()});
    if (p.contains("profile_95"))
      fit.parameters.back().profile = fit::ProfileInterval{p.at("profile_68").at(0).get<double>(), p.at("profile_68").at(1).get<double>(), p.at("profile_95").at(0).get<double>(),
                                                           p.at("profile_95").at(1).get<double>()};
  }
  return fit;
}

std::string parameters_table(const fit::FitResult& fit, const brdf::CookTorrance* truth) {
  std::vector<std::string> columns{"parameter", "fitted"};
  if (truth) columns.push_back("truth");
  columns.push_back("note");
  std::vector<std::vector<std::string>> rows;
  for (const ParameterRow& row : parameter_rows(fit, truth)) {
    rows.push_back({row.name, row.fitted});
    if (truth) rows.back().push_back(row.truth);
    rows.back().push_back(row.note);
  }
  return html_table("Fitted parameters with standard errors; digits as the error has them", columns, rows);
}

/// Coloured by size: red positive, blue negative.
std::string correlation_table(const Json& j) {
  const Json& rows = j.at("correlation");
  std::string html = "<details><summary>Correlations of the errors</summary><div class=scroll><table><caption>Correlation of each pair of parameters</caption><thead><tr><th scope=col></th>";
  for (const Json& p : j.at("parameters")) html += "<th scope=col>" + html_escaped(p.at("name").get<std::string>()) + "</th>";
  html += "</tr></thead><tbody>\n";
  for (std::size_t i = 0; i < rows.size(); ++i) {
    html += "<tr><th scope=row>" + html_escaped(j.at("parameters").at(i).at("name").get<std::string>()) + "</th>";
    for (const Json& value : rows[i]) {
      const double c = value.get<double>();
      html += fmt::format("<td class=number style=\"background:rgb({} / {:.2f})\">{:.2f}</td>", c >= 0 ? "178 24 43" : "33 102 172", 0.35 * std::min(1.0, std::abs(c)), c);
    }
    html += "</tr>\n";
  }
  return html + "</tbody></table></div></details>\n";
}

std::string model_text(const Json& j) {
  std::string text;
  for (const Json& lobe : j.at("lobes")) text += fmt::format("{}m {:.4g} r {:.3g}", text.empty() ? "" : ", ", lobe.at("m").get<double>(), lobe.at("r").get<double>());
  return text.empty() ? "diffuse only" : text;
}

std::string candidates_table(const Json& j) {
  std::vector<std::vector<std::string>> rows;
  std::vector<std::string> columns{"structure", "mean |ln|", "parameters", "criterion", "lobes"};
  const auto timed = [](const Json& c) { return c.contains("evaluation_ns"); };
  const bool times = std::any_of(j.at("candidates").begin(), j.at("candidates").end(), timed);
  if (times) columns.push_back("ns per value");
  for (const Json& c : j.at("candidates")) {
    rows.push_back({c.at("structure").get<std::string>(), fmt::format("{:.5f}", c.at("mean_abs_log").get<double>()), fmt::format("{}", c.at("n_parameters").get<int>()),
                    fmt::format("{:+.4g}", c.at("criterion").get<double>()), model_text(c)});
    if (times) rows.back().push_back(timed(c) ? fmt::format("{:.2f}", c.at("evaluation_ns").get<double>()) : "–");
  }
  return rows.empty() ? "" : html_table("Structures that were tried, the chosen one first; the smallest criterion wins", columns, rows);
}

std::string errors_table(const Json& j) {
  const Json& e = j.at("errors");
  const auto number = [&](const char* key, const char* format) { return fmt::format(fmt::runtime(format), e.at(key).get<double>()); };
  return html_table("Fit to the table", {"figure", "value"},
                    {{"mean |ln(fit / table)|", number("mean_abs_log", "{:.5f}")},
                     {"rms ln", number("rms_log", "{:.5f}")},
                     {"χ² per degree of freedom", number("reduced_chi2", "{:.3f}")},
                     {"relative error that cells share", number("shared_error", "{:.4f}")},
                     {"albedo at normal incidence, largest channel", number("energy", "{:.3f}")},
                     {"cells used", fmt::format("{} of {}", e.at("n_cells").get<std::size_t>(), e.at("n_cells_available").get<std::size_t>())},
                     {"scale", j.at("scale").get<std::string>()}});
}

}  // namespace

std::vector<std::string> fit_warnings(const std::filesystem::path& file) {
  return with_fit_json(file, [&](const Json& j) {
    std::vector<std::string> list;
    if (!j.contains("parameters")) return list;
    const Json& errors = j.at("errors");
    if (!errors.at("converged").get<bool>()) list.push_back("The fit did not converge: " + errors.at("message").get<std::string>());
    if (errors.at("energy").get<double>() > 1) list.push_back(fmt::format("The fitted paint reflects more than it receives: albedo {:.3f} at normal incidence.", errors.at("energy").get<double>()));
    std::string open, bound;
    const auto add = [](std::string& names, const std::string& name) { names += (names.empty() ? "" : ", ") + name; };
    for (const auto& p : parameters_of(j, file).parameters) {
      if (!p.determined) add(open, p.name);
      if (p.determined && p.at_bound) add(bound, fmt::format("{} = {:.4g}", p.name, p.value));
    }
    if (!open.empty()) list.push_back("Not determined by the data, so no measurement: " + open + ".");
    if (!bound.empty()) list.push_back("At a bound of what is allowed, so no measurement: " + bound + ".");
    return list;
  });
}

HtmlSection parameters_section(const std::filesystem::path& file, const brdf::Brdf* truth) {
  const auto* true_paint = dynamic_cast<const brdf::CookTorranceBrdf*>(truth);
  return with_fit_json(file, [&](const Json& j) -> HtmlSection {
    const std::string model = "<details><summary>As a paint entry</summary><pre>" + html_escaped(brdf::model_to_json(brdf::read_model(file))) + "</pre></details>\n";
    if (!j.contains("parameters")) return {"parameters", "Parameters", "<p>A model without errors: nothing was fitted.</p>\n" + model};
    return {"parameters", true_paint ? "Parameters beside the truth" : "Parameters",
            parameters_table(parameters_of(j, file), true_paint ? &true_paint->model() : nullptr) + errors_table(j) + candidates_table(j) + correlation_table(j) + model};
  });
}

}  // namespace lacquer::tools
