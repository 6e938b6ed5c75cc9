#pragma once

#include <string>
#include <vector>

#include "libbrdf/metrics.h"
#include "libcalib/samples.h"
#include "libfit/fit.h"

/// Texts that several commands print.
namespace lacquer::tools {

/// cos of an angle given in degrees on the command line; Error{usage} naming `option` unless it lies in (0, 90).
double cosine_of_degrees(const std::string& option, double degrees);

/// Samples used and left out, cells covered.
std::string coverage_text(const calib::Tabulation& tabulation);

/// A fitted parameter for people: value with error, the true value or "", a note or "".
struct ParameterRow {
  std::string name, fitted, truth, note;
};
std::vector<ParameterRow> parameter_rows(const fit::FitResult& fit, const brdf::CookTorrance* truth);

/// Fitted parameters with standard errors, digits matched to the error; with `truth` a column beside them (each lobe beside
/// the true one that it resembles most).
std::string parameter_table(const fit::FitResult& fit, const brdf::CookTorrance* truth);

/// The metrics of `difference`, one per line, with units.
std::string difference_text(const brdf::BrdfDifference& difference);

}  // namespace lacquer::tools
