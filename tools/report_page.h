#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "libacquire/session.h"
#include "libbrdf/brdf.h"
#include "libcalib/calibration.h"
#include "tools/html.h"

/// The page of `lacquer report`: one self-contained file of at most some MB that needs no network and no scripts.
namespace lacquer::tools {

/// A BRDF with the name that the page calls it by.
struct ReportBrdf {
  std::string name;
  std::string file;
  std::shared_ptr<const brdf::Brdf> brdf;
};

struct ReportOptions {
  std::filesystem::path probe;  ///< light probe; empty: the one that comes with Lacquer
  double max_theta_deg = 80;    ///< of comparisons
};

/// What the report needs of a session; parts that are not there yet are left out of the page.
struct ReportSession {
  acquire::Session session;
  std::optional<calib::Calibration> calibration;
  std::vector<ReportBrdf> brdfs;  ///< table, fit, truth (simulated rig): those that there are
  const ReportBrdf* find(const std::string& name) const;
};
ReportSession read_report_session(const std::filesystem::path& folder);

/// Page of a session; its warnings first.
void write_session_report(const std::filesystem::path& folder, const std::filesystem::path& output, const ReportOptions& options);
/// Page of any BRDFs, the first one the reference of the comparisons.
void write_brdf_report(const std::vector<ReportBrdf>& brdfs, const std::filesystem::path& output, const ReportOptions& options);

/// BRDF files with names that tell them apart.
std::vector<ReportBrdf> load_named_brdfs(const std::vector<std::string>& files);

// Its sections. Internal to the report.
HtmlSection capture_section(const ReportSession& s);
HtmlSection sensor_section(const ReportSession& s);
HtmlSection geometry_section(const ReportSession& s);
/// The lens: what it leaves of the chessboards' corners, its uncertainty over the image, its distortion; as much of it as the rig's
/// lens file states. The session has a calibration.
std::string lens_figures(const ReportSession& s);
HtmlSection photographs_section(const ReportSession& s);
/// Parameters, correlations, candidates, minima of a fit.json.
HtmlSection parameters_section(const std::filesystem::path& fit_file, const brdf::Brdf* truth);
std::vector<std::string> fit_warnings(const std::filesystem::path& fit_file);
/// Metrics of every BRDF against the first.
HtmlSection comparison_section(const std::vector<ReportBrdf>& brdfs, const ReportOptions& options);
HtmlSection lobes_section(const std::vector<ReportBrdf>& brdfs);
HtmlSection slices_section(const std::vector<ReportBrdf>& brdfs);
HtmlSection spheres_section(const std::vector<ReportBrdf>& brdfs, const ReportOptions& options);

}  // namespace lacquer::tools
