#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "libbrdf/brdf.h"
#include "libbrdf/table.h"
#include "tools/plot.h"
#include "tools/rgb_image.h"

/// Plots of BRDFs for `lacquer plot`, `compare` and `report`. Curves and slices show the green channel.
namespace lacquer::tools {

struct NamedBrdf {
  std::string name;
  const brdf::Brdf* brdf;
};

/// A picture as gnuplot draws it.
struct Plot {
  std::string script;
  PlotSize size;
  std::string alt;  ///< what is to be seen, for who does not see it
};

/// Lobes in the plane of incidence, one colour per angle of incidence (degrees); the first BRDF as points, the others as lines.
/// f_r over the angle of the camera, logarithmic.
Plot log_plot(const std::vector<NamedBrdf>& brdfs, const std::vector<double>& incidence_deg);
/// Radius is the cube root of f_r, so that peak and base can both be seen.
Plot polar_plot(const std::vector<NamedBrdf>& brdfs, const std::vector<double>& incidence_deg);

/// theta_h (down, the table's cells) x theta_d (right) at one phi_d, NaN where there is nothing.
struct Slice {
  std::vector<double> values = std::vector<double>(brdf::TableGrid::n_theta_h * brdf::TableGrid::n_theta_d);
  double low = 0, high = 1;  ///< colours' range
  bool diverging = false;    ///< symmetric about 0: blue, white, red; else dark to bright
  bool logarithmic = false;  ///< values are log10
  std::string unit;
};
using SliceValue = std::function<std::optional<double>(const brdf::TableGrid::Cell&)>;
Slice slice_of(const SliceValue& value, int phi_d_cell = brdf::TableGrid::n_phi_d / 2);
/// log10 of the green channel: of a table its cells as they are, of anything else its value at the cells' centres.
Slice log_slice(const brdf::Brdf& brdf, int phi_d_cell = brdf::TableGrid::n_phi_d / 2);
/// ln(b / a) where both say something positive; a table is compared at the mean coordinates of its cells' samples.
Slice log_ratio_slice(const brdf::Brdf& a, const brdf::Brdf& b, int phi_d_cell = brdf::TableGrid::n_phi_d / 2);
/// Mean ln(model / table) over phi_d and channels, at the mean coordinates of the cells' samples.
Slice residual_slice(const brdf::HalfAngleTable& table, const brdf::CookTorrance& model);
/// Sets low and high to the finite values' range, of all slices together.
void share_range(std::vector<Slice*> slices);
Plot slice_plot(const Slice& slice, const std::string& title);
/// One byte per cell for the page's read-out, base64: 0 nothing, 1..255 from low to high.
std::string slice_codes(const Slice& slice);

/// Share of the reachable cells over phi_d that was measured (or known by symmetry), per cent.
Slice coverage_slice(const brdf::HalfAngleTable& table);

Plot delta_e_plot(const DeltaE& difference, const std::string& title);

}  // namespace lacquer::tools
