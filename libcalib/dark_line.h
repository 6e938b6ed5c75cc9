#pragma once

#include <vector>

#include "libcalib/photon_transfer.h"

/// Mean of dark frames over exposure time. Internal to libcalib.
namespace lacquer::calib {

/// Mean of one dark frame (or of one of its channels).
struct DarkMean {
  double exposure_s = 0;
  double mean = 0;      ///< linearised DN
  double variance = 0;  ///< of `mean`, from temporal noise alone
};

/// mean = base.value + rate.value * t. Where frames of one exposure time differ by more than their temporal noise (drift of the black
/// level), or the means do not follow a line, the standard errors are widened by sqrt(chi^2 / dof).
struct DarkLine {
  Measured base;                 ///< linearised DN at t = 0; with one exposure time the mean at that time
  std::optional<Measured> rate;  ///< linearised DN per second; empty with one exposure time
  double chi_square = 0;
  int degrees_of_freedom = 0;
};
DarkLine fit_dark_line(const std::vector<DarkMean>& means);

}  // namespace lacquer::calib
