#include <cstddef>
#include <cstdint>
#include <string>

#include "libacquire/lens_file.h"
#include "libbrdf/error.h"

/// mrcal's .cameramodel. Anything but a lens or a lacquer::Error is a finding.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    const auto lens = lacquer::acquire::parse_lens(std::string(reinterpret_cast<const char*>(data), size), "fuzz.cameramodel");
    (void)lacquer::acquire::camera_of(lens, "fuzz.cameramodel");
  } catch (const lacquer::Error&) {
  }
  return 0;
}
