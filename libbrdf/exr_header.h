#pragma once

#include <filesystem>
#include <string>

namespace lacquer::brdf {

struct ExrExpectation {
  int width;         ///< pixels
  int height;        ///< pixels
  int max_channels;  ///< a line buffer has room for all of them
  std::string what;  ///< for messages: "a table of Lacquer"
};

/// Looks at an OpenEXR header before OpenEXR does: single-part scan lines, data window (0, 0) to (width-1, height-1), every
/// attribute inside the file, no more channels than expected. OpenEXR allocates what a header asks for (gigabytes, if a hostile one says so) before any of our
/// checks could run. Throws Error{file}.
void check_exr_header(const std::filesystem::path& file, const ExrExpectation& expected);

}  // namespace lacquer::brdf
