#include "tools/report_page.h"

#include <fmt/format.h>

#include <algorithm>
#include <numbers>
#include <nlohmann/json.hpp>

#include "libbrdf/files.h"
#include "libbrdf/physical_checks.h"
#include "libbrdf/table.h"
#include "tools/measure_record.h"

namespace lacquer::tools {

namespace {

namespace fs = std::filesystem;

const brdf::HalfAngleTable* table_of(const ReportBrdf* b) {
  const auto* table = b ? dynamic_cast<const brdf::TableBrdf*>(b->brdf.get()) : nullptr;
  return table ? &table->table() : nullptr;
}

std::string warning_list(const std::vector<std::string>& warnings) {
  if (warnings.empty()) return "<p>No warnings.</p>\n";
  std::string html;
  for (const auto& w : warnings) html += "<div class=warning role=note>" + html_escaped(w) + "</div>\n";
  return html;
}

/// JSON text indented; as it is where it is none.
std::string indented(const std::string& json) {
  const auto parsed = nlohmann::ordered_json::parse(json, nullptr, false);
  return parsed.is_discarded() ? json : parsed.dump(1);
}

/// Where a model reflects more light than it receives; with a relative scale, where it reflects far more than at normal incidence. Fits say
/// so of normal incidence only, and a lobe of small r grows without bound towards grazing, where often nothing was measured.
std::vector<std::string> reflectance_warnings(const ReportBrdf& b, bool absolute) {
  if (!dynamic_cast<const brdf::CookTorranceBrdf*>(b.brdf.get())) return {};
  constexpr double degree = std::numbers::pi / 180;
  const auto reflectances = brdf::check_physics(*b.brdf, {.theta_i = {0, 45 * degree, 60 * degree, 75 * degree}, .resolution = 90}).reflectances;
  const auto largest = [](const brdf::Reflectance& r) { return std::max({r.value.x, r.value.y, r.value.z}); };
  const double limit = absolute ? 1 : 10 * largest(reflectances.front());
  for (const auto& r : reflectances)
    if (largest(r) > 1.01 * limit && largest(r) > 0)
      return {fmt::format("{}: light from {:.0f}° is reflected {}. The model is not to be believed there.", b.name, r.theta_i / degree,
                          absolute ? fmt::format("to {:.3g} times what comes in", largest(r)) : fmt::format("{:.3g} times as strongly as light from the normal", largest(r) / (limit / 10)))};
  return {};
}

std::vector<std::string> session_warnings(const ReportSession& s) {
  std::vector<std::string> list;
  const fs::path fit = s.session.folder / "fit.json";
  if (fs::exists(fit)) list = fit_warnings(fit);
  if (!s.calibration) {
    list.push_back("There is no calibration.json: nothing of sensor and geometry is known, and nothing was merged.");
    return list;
  }
  if (s.calibration->geometry_source == "rig file") list.push_back("Geometry (lens, sphere, lights, axis) is taken from the rig file, not estimated from the images.");
  const brdf::HalfAngleTable* table = table_of(s.find("table"));
  if (const ReportBrdf* model = s.find("fit"))
    for (auto& w : reflectance_warnings(*model, !table || table->absolute_scale)) list.push_back(std::move(w));
  if (table && !table->absolute_scale) list.push_back("The scale is relative: no reference of known reflectance was measured. kd and ks are in arbitrary units.");
  if (!table) list.push_back("There is no table.exr yet (lacquer tabulate).");
  if (!s.find("fit")) list.push_back("There is no fit.json yet (lacquer fit).");
  return list;
}

HtmlSection provenance_section(const ReportSession& s) {
  std::string html = fmt::format("<p>Captured by {} with <code>{}</code>.</p>\n", html_escaped(s.session.software), html_escaped(s.session.command_line));
  if (const auto record = read_measure_record(s.session.folder / "measure.json")) {
    std::vector<std::vector<std::string>> rows;
    for (const auto& [stage, seconds] : record->seconds) rows.push_back({stage, fmt::format("{:.2f} s", seconds)});
    html += html_table("Time of every stage, wall clock", {"stage", "time"}, rows);
  }
  if (const auto* table = table_of(s.find("table"))) html += "<details><summary>Provenance of the table</summary><pre>" + html_escaped(indented(table->provenance_json)) + "</pre></details>\n";
  html += "<details><summary>Rig file</summary><pre>" + html_escaped(s.session.rig.text) + "</pre></details>\n";
  return {"provenance", "Provenance", html};
}

}  // namespace

const ReportBrdf* ReportSession::find(const std::string& name) const {
  const auto found = std::find_if(brdfs.begin(), brdfs.end(), [&](const auto& b) { return b.name == name; });
  return found == brdfs.end() ? nullptr : &*found;
}

ReportSession read_report_session(const fs::path& folder) {
  ReportSession s{acquire::read_session(folder), {}, {}};
  if (fs::exists(folder / "calibration.json")) s.calibration = calib::read_calibration(folder / "calibration.json");
  const auto add = [&](const char* name, const fs::path& file) {
    if (!file.empty() && fs::exists(file)) s.brdfs.push_back({name, file.string(), brdf::load_brdf(file)});
  };
  add("table", folder / "table.exr");
  add("fit", folder / "fit.json");
  if (s.session.rig.kind == acquire::RigDescription::Kind::simulated) add("truth", s.session.rig.simulation.paint);
  return s;
}

void write_session_report(const fs::path& folder, const fs::path& output, const ReportOptions& options) {
  const ReportSession s = read_report_session(folder);
  const fs::path full = fs::absolute(folder).lexically_normal();
  const std::string name = full.filename().empty() ? full.parent_path().filename().string() : full.filename().string();
  std::vector<HtmlSection> sections;
  const ReportBrdf* truth = s.find("truth");
  if (s.find("fit")) sections.push_back(parameters_section(folder / "fit.json", truth ? truth->brdf.get() : nullptr));
  // What was measured, fit and truth together where a table is there; a truth alone is no measurement.
  const bool measured = s.find("table") || s.find("fit");
  if (measured && s.brdfs.size() > 1) sections.push_back(comparison_section(s.brdfs, options));
  if (measured && s.calibration) sections.push_back(photographs_section(s));
  if (measured) {
    sections.push_back(spheres_section(s.brdfs, options));
    sections.push_back(lobes_section(s.brdfs));
    sections.push_back(slices_section(s.brdfs));
  }
  sections.push_back(capture_section(s));
  if (s.calibration) {
    sections.push_back(sensor_section(s));
    sections.push_back(geometry_section(s));
  }
  sections.push_back(provenance_section(s));
  std::string introduction = warning_list(session_warnings(s));
  if (const auto record = read_measure_record(folder / "measure.json")) introduction += "<pre>" + html_escaped(record->coverage) + "</pre>\n";
  brdf::write_text_atomically(output, html_page("Lacquer: " + name, introduction, sections));
}

void write_brdf_report(const std::vector<ReportBrdf>& brdfs, const fs::path& output, const ReportOptions& options) {
  std::vector<std::string> warnings;
  std::vector<std::vector<std::string>> rows;
  std::vector<HtmlSection> sections;
  int n_fits = 0;
  for (const auto& b : brdfs) {
    rows.push_back({b.name, b.brdf->description(), b.file});
    if (const auto* table = table_of(&b); table && !table->absolute_scale) warnings.push_back(b.name + ": the scale is relative.");
    if (!dynamic_cast<const brdf::CookTorranceBrdf*>(b.brdf.get())) continue;
    for (const auto& w : fit_warnings(b.file)) warnings.push_back(b.name + ": " + w);
    HtmlSection parameters = parameters_section(b.file, nullptr);
    parameters.id += std::to_string(++n_fits);
    parameters.title += " of " + b.name;
    sections.push_back(std::move(parameters));
  }
  if (brdfs.size() > 1) sections.push_back(comparison_section(brdfs, options));
  sections.push_back(spheres_section(brdfs, options));
  sections.push_back(lobes_section(brdfs));
  sections.push_back(slices_section(brdfs));
  sections.push_back({"files", "Files", html_table("BRDFs of this page", {"name", "what", "file"}, rows)});
  std::string title = "Lacquer:";
  for (const auto& b : brdfs) title += (&b == &brdfs.front() ? " " : ", ") + b.name;
  brdf::write_text_atomically(output, html_page(title, warning_list(warnings), sections));
}

}  // namespace lacquer::tools
