#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <fstream>

#include "libbrdf/brdf.h"
#include "libbrdf/error.h"

/// Every BRDF file: model JSON, table EXR, MERL, RGL, .mbsdf, .npy, CSV. Anything but a value or a lacquer::Error is a finding.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const char* file = std::getenv("LACQUER_FUZZ_FILE") ? std::getenv("LACQUER_FUZZ_FILE") : "/dev/shm/lacquer-fuzz";
  std::ofstream(file, std::ios::binary).write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
  try {
    const auto brdf = lacquer::brdf::load_brdf(file);
    for (const double theta : {0.0, 0.4, 1.5}) (void)brdf->value({lacquer::brdf::direction(theta, 0), lacquer::brdf::direction(0.7, 2)});
  } catch (const lacquer::Error&) {
  }
  return 0;
}
