#pragma once

#include <filesystem>

#include "libbrdf/table.h"

/// The half-angle table for spreadsheets and numerical software. Readers treat the file as hostile, writers rename a temporary.
namespace lacquer::brdf {

/// First characters of a table in CSV and of every NumPy array; load_brdf tells the formats by them.
inline constexpr char csv_magic[] = "# lacquer table";
inline constexpr char npy_magic[] = "\x93NUMPY";

/// CSV, one row per cell that is not empty in some channel. Two comment lines (`#`: version, unit, scale; provenance as JSON), the
/// header theta_h_cell,theta_d_cell,phi_d_cell,theta_h_deg,theta_d_deg,phi_d_deg and per channel c in {r, g, b} or {y}
/// c_mean,c_sigma,c_count,c_origin. Angles are those of the cell's centre, in degrees; mean and sigma (standard error of the mean) in
/// 1/sr with the fewest digits that read back to the same float; origin is measured, symmetric, filled or modelled. The four fields of a
/// channel that is empty there are empty: no NaN is ever written. Lost: the samples' mean coordinates and footprints.
void write_table_csv(const std::filesystem::path& file, const HalfAngleTable& table);
/// Coordinates of a cell become its centre, footprints 0. The columns theta_h_deg, theta_d_deg, phi_d_deg are not read.
HalfAngleTable read_table_csv(const std::filesystem::path& file);

/// NumPy .npy, version 1.0: float32, C order, shape (90, 90, 180, C), axes theta_h, theta_d, phi_d, channel; f_r in 1/sr at the
/// cell's centre, NaN in empty cells and nowhere else. Beside it FILE.json with unit, scale, axes and provenance, and, if `with_sigma`, the
/// standard error of the mean in the same shape as NAME.sigma.npy. Lost: count, origin, mean coordinates, footprints.
void write_table_npy(const std::filesystem::path& file, const HalfAngleTable& table, bool with_sigma);
/// Reads float32 or float64 of that shape; NaN is an empty cell, an infinity an error. Every other cell counts as measured once, at its
/// centre. NAME.sigma.npy and FILE.json are read where they are there.
HalfAngleTable read_table_npy(const std::filesystem::path& file);

/// NAME.sigma.npy of NAME.npy.
std::filesystem::path sigma_file(const std::filesystem::path& npy_file);

/// FILE.json beside a binary file that cannot say it itself: format, unit, colour space, scale, provenance.
void write_side_file(const std::filesystem::path& file, const HalfAngleTable& table, const std::string& format);

/// f_r averaged over swapping the directions: what a table, whose cells hold both, can keep of a measurement that is not reciprocal.
class ReciprocalMean final : public Brdf {
 public:
  explicit ReciprocalMean(const Brdf& brdf) : brdf_(brdf) {}
  std::string description() const override { return brdf_.description() + ", mean of both directions"; }

 private:
  std::optional<glm::dvec3> do_value(const Directions& d, const Footprint<double>& footprint) const override;
  const Brdf& brdf_;
};

}  // namespace lacquer::brdf
