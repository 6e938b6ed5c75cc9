#include <cstddef>
#include <cstdint>
#include <string>

#include "libacquire/lens_residuals.h"
#include "libbrdf/error.h"

/// mrcal's .cameramodel. Anything but a lens or a lacquer::Error is a finding.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const std::string text(reinterpret_cast<const char*>(data), size);
    (void)lacquer::acquire::parse_corner_residuals(text, "fuzz.cameramodel");
    const auto lens = lacquer::acquire::parse_lens(text, "fuzz.cameramodel");
    (void)lacquer::acquire::camera_of(lens, "fuzz.cameramodel");
  } catch (const lacquer::Error&) {
  }
  return 0;
}
