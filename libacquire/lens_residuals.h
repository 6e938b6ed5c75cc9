#pragma once

#include <filesystem>
#include <glm/vec2.hpp>
#include <string>
#include <vector>

#include "libacquire/lens_file.h"

namespace lacquer::acquire {

/// A corner of a chessboard in one of the photographs that a lens was calibrated from, pixels.
struct CornerResidual {
  glm::dvec2 found{0.0};
  glm::dvec2 residual{0.0};  ///< found minus where the lens puts it
};

/// The same text with what the lens leaves of the corners that count, as the entry 'lacquer_corner_residuals', which mrcal ignores.
/// Of more than 20 000 corners evenly spread ones are kept, so that the file can be read.
std::string cameramodel_text(const Lens& lens, const std::string& note, const OptimizationInputs& inputs, const std::vector<CornerResidual>& corners);

/// That entry of a .cameramodel; empty where there is none. Throws Error{file} as read_lens.
std::vector<CornerResidual> read_corner_residuals(const std::filesystem::path& file);
std::vector<CornerResidual> parse_corner_residuals(const std::string& text, const std::string& file);

}  // namespace lacquer::acquire
