#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "libbrdf/brdf.h"
#include "libbrdf/table.h"

/// BRDF files. Readers treat every file as hostile: sizes are checked before allocation, errors are Error{file} with one line that
/// names file, field and what was expected. Writers go to a temporary name in the same folder and rename.
namespace lacquer::brdf {

/// Our table: EXR, 16200 x 90 pixels (x = phi_d + 180 theta_d, y = theta_h), ZIPS. Channels per colour C in {R, G, B} or {Y}:
/// C.mean, C.variance, C.theta_h, C.theta_d, C.phi_d, C.footprint_along, C.footprint_across,
/// C.footprint_mixed (float), C.count, C.origin (uint), everything 0 in empty cells.
/// C.origin holds CellOrigin's values. Header attributes "lacquer.version" (int, 2; files of version 1, without clipped cells, are read), "lacquer.absolute_scale" (int), "lacquer.scale_sigma" (double), "lacquer.provenance" (string, JSON).
/// The writer refuses a table that the reader would (NaN, negative variance, values in empty cells) with Error{input}.
void write_table(const std::filesystem::path& file, const HalfAngleTable& table);
HalfAngleTable read_table(const std::filesystem::path& file);

/// MERL .binary, value at the cell's centre. -1 is written to all planes of a cell that is empty in some channel, whose mean is negative
/// (noise; the format cannot tell it from "empty") or whose centre has a direction below the horizon. One-channel tables are
/// written to all three planes. Relative or camera-RGB values are the caller's to state.
void write_merl(const std::filesystem::path& file, const HalfAngleTable& table);
/// A cell that is negative in any plane becomes an empty cell; count is 1, variance 0, the coordinates are the cell's centre.
HalfAngleTable read_merl(const std::filesystem::path& file);

/// RGL/EPFL tensor file .bsdf (Dupuy and Jakob 2018), isotropic; anisotropic files are an error that says so. `wi` is the file's
/// incident direction: measurements are not exactly reciprocal. Values are those of RGL's reference loader (powitacq_rgb), divided by
/// cos(theta_o): linear between the file's theta_i, constant beyond them, negative colours (out of gamut) taken as 0. A file with two
/// azimuths is read at phi_i = 0. `rgb` files as they are; `spectra` files are integrated to linear sRGB under equal energy with the
/// CIE 1931 matching functions, see rgl_spectrum.h; a constant spectrum 1 becomes (1, 1, 1).
std::unique_ptr<Brdf> read_rgl(const std::filesystem::path& file);

/// Model of a fit.json or of a bare {"kd": [r,g,b], "lobes": [{"ks": [r,g,b], "m": m, "r": r}]}.
/// Checks: kd, ks in [0, 1e6], m in (0, 1] and at least 1e-6, r in [0, 1], at most 16 lobes, 64 MB; unknown keys are allowed.
CookTorrance read_model(const std::filesystem::path& file);
CookTorrance model_from_json(const std::string& text, const std::string& name_for_errors);
/// {"kd": ..., "lobes": ...} with the fewest digits that read back to the same numbers, the paint entry of papers/table1.json.
std::string model_to_json(const CookTorrance& model);

/// Writes `file` through a temporary name in its folder and a rename; `write` gets the temporary path. On an exception the
/// temporary is removed and `file` is untouched.
void write_atomically(const std::filesystem::path& file, const std::function<void(const std::filesystem::path&)>& write);
void write_text_atomically(const std::filesystem::path& file, const std::string& text);

/// Whole file; Error{file} if it is missing, not a regular file or larger than `max_bytes`.
std::vector<std::byte> read_bytes(const std::filesystem::path& file, std::uint64_t max_bytes);
std::string read_text(const std::filesystem::path& file, std::uint64_t max_bytes = 64u << 20);

/// The first bytes of a file, at most `max_bytes`.
std::vector<std::byte> read_prefix(const std::filesystem::path& file, std::size_t max_bytes);

/// XXH3-128 as 32 hex digits, what `xxhsum -H2` prints.
std::string checksum(std::span<const std::byte> bytes);
std::string file_checksum(const std::filesystem::path& file);

/// Software version, e.g. "0.1.0".
const char* version();

}  // namespace lacquer::brdf
