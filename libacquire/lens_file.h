#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "libacquire/rig_geometry.h"

namespace lacquer::acquire {

/// A calibrated lens as mrcal writes it into a .cameramodel file.
struct Lens {
  std::string model;               ///< mrcal's name, e.g. "LENSMODEL_OPENCV8"
  int width = 0, height = 0;       ///< of the image, pixels
  std::vector<double> intrinsics;  ///< fx fy cx cy in pixels, then the model's own; pixel (0, 0) is a pixel's centre
  /// Of the intrinsics, row-major, the board poses of the calibration being free; empty: the file does not say. mrcal's own files never do:
  /// it is the entry 'lacquer_intrinsics_covariance', which mrcal ignores.
  std::vector<double> covariance;
};

/// What mrcal's tools want to know of a calibration besides its result: "optimization_inputs", base-85 text. Empty: left out.
using OptimizationInputs = std::string;

/// Text of a .cameramodel of a camera at the origin; `note` goes above it as a comment.
std::string cameramodel_text(const Lens& lens, const std::string& note, const OptimizationInputs& inputs);

/// Reads a .cameramodel, a Python literal, as hostile text: at most 64 MB and 200 000 numbers. All models of mrcal are read; the extrinsics
/// and optimization inputs are not. Throws Error{file}: file, entry, what was expected.
Lens read_lens(const std::filesystem::path& file);
Lens parse_lens(const std::string& text, const std::string& file);

/// The camera that sees through `lens`: LENSMODEL_PINHOLE, OPENCV4, OPENCV5 and OPENCV8. Throws Error{file} with the name `file` for another model.
CameraModel camera_of(const Lens& lens, const std::string& file);

}  // namespace lacquer::acquire
