#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "libbrdf/brdf.h"
#include "libbrdf/directions.h"

namespace lacquer::brdf {

/// Grid of the half-angle table, MERL's: theta_h cells with edges (i/n)^2 * 90 deg (narrow at the peak), theta_d linear over
/// 0..90 deg, phi_d linear over [0, pi) (reciprocity folds phi_d and phi_d + pi together).
struct TableGrid {
  static constexpr int n_theta_h = 90;
  static constexpr int n_theta_d = 90;
  static constexpr int n_phi_d = 180;
  static constexpr std::size_t n_cells = std::size_t{n_theta_h} * n_theta_d * n_phi_d;

  struct Cell {
    int theta_h, theta_d, phi_d;
  };

  /// MERL's order: phi_d fastest, then theta_d, then theta_h.
  static std::size_t index(const Cell& c) {
    return static_cast<std::size_t>(c.phi_d) +
           n_phi_d * (static_cast<std::size_t>(c.theta_d) + std::size_t{n_theta_d} * static_cast<std::size_t>(c.theta_h));
  }
  static Cell cell(std::size_t index);

  /// Cell of coordinates with theta_h, theta_d in [0, pi/2] and any phi_d.
  static Cell cell(const HalfDiff& c);
  static std::size_t index(const HalfDiff& c) { return index(cell(c)); }

  static double theta_h_edge(int i);         ///< lower edge of cell i, radians; i = n_theta_h: pi/2
  static HalfDiff centre(const Cell& c);     ///< theta_h centre is ((i+0.5)/n)^2 * 90 deg, as MERL readers expect
  static HalfDiff centre(std::size_t index) { return centre(cell(index)); }

  /// The cell at pi - phi_d: the same for an isotropic paint without a handedness.
  static std::size_t mirror(std::size_t index) { return index - index % n_phi_d + (n_phi_d - 1 - index % n_phi_d); }

  /// Both directions at the cell's centre are above the horizon: smaller cosine > `min_cosine`.
  static bool reachable(const Cell& c, double min_cosine = 0.0);
};

/// Where a cell's value comes from. Only `measured` cells enter a fit as values, `clipped` ones as lower bounds.
enum class CellOrigin : std::uint8_t {
  empty = 0,
  measured = 1,   ///< samples fell into this cell
  symmetric = 2,  ///< taken from the mirror cell phi_d -> pi - phi_d (isotropic, mirror-symmetric paint)
  filled = 3,     ///< interpolated from neighbours
  modelled = 4,   ///< from a fit
  clipped = 5,    ///< every sample was clipped: `mean` is a lower bound of the value, not a value
};

/// The cell says what the BRDF is there, whatever the source; an empty cell says nothing, a clipped one only a bound.
constexpr bool has_value(CellOrigin origin) { return origin != CellOrigin::empty && origin != CellOrigin::clipped; }

/// One colour channel of a table, each vector of length TableGrid::n_cells; entries of empty cells are 0.
///
/// Clipped samples ("at least this") become bounds: a cell that has nothing else is `clipped`, its mean the irradiance-weighted mean of
/// the samples' lower bounds, its variance the noise of that, its count and coordinates those of the clipped samples. So the BRDF at
/// these coordinates is at least `mean`, which a one-sided residual max(0, mean - f) / sigma takes into a fit. A cell with any other sample
/// is `measured` by those alone: their mean coordinates and footprints are their own, so leaving out the clipped ones moves the value
/// and the place where it holds together. Mirror symmetry passes values on, never bounds.
struct TableChannel {
  std::vector<float> mean;          ///< 1/sr; may be negative where the signal is below the noise; `clipped`: a lower bound
  std::vector<float> variance;      ///< of the mean, (1/sr)^2; 0 means exact (synthetic)
  std::vector<std::uint32_t> count; ///< samples in the cell
  std::vector<float> theta_h, theta_d, phi_d;  ///< weighted mean coordinates of the samples, radians, phi_d in [0, pi)
  std::vector<float> footprint_along, footprint_across, footprint_mixed;  ///< weighted mean footprint of the samples; 0: points
  std::vector<CellOrigin> origin;

  TableChannel();
};

/// Half-angle BRDF table 90 x 90 x 180 after Rusinkiewicz 1998 and Günther et al. 2005, 4.1.
struct HalfAngleTable {
  std::vector<TableChannel> channels;  ///< 1 (Y) or 3 (R, G, B)
  bool absolute_scale = true;          ///< false: values are relative, no reference of known reflectance was used
  double scale_sigma = 0;              ///< relative standard error of the scale, common to all values and not in their variance
  std::string provenance_json = "{}";  ///< command line, versions, input checksums, seed, units, colour space

  explicit HalfAngleTable(std::size_t n_channels = 3) : channels(n_channels) {}
};

/// Noise-free table of a BRDF evaluated at the cell centres, cells with a cosine <= `min_cosine` left empty. For tests and conversion.
HalfAngleTable tabulate_brdf(const Brdf& brdf, double min_cosine = 0.0);

/// Table behind the common interface. Lookup: trilinear in (theta_h index, theta_d, phi_d) over the corner cells that have a
/// value, nullopt where the nearest cell has none.
class TableBrdf final : public Brdf {
 public:
  /// Throws Error{input} unless the table has 1 or 3 channels.
  TableBrdf(HalfAngleTable table, std::string description, bool interpolate = true);
  const HalfAngleTable& table() const { return table_; }
  std::string description() const override { return description_; }

 private:
  std::optional<glm::dvec3> do_value(const Directions& d, const Footprint<double>& /*footprint*/) const override;
  HalfAngleTable table_;
  std::string description_;
  bool interpolate_;
};

}  // namespace lacquer::brdf
