#include <cstddef>
#include <cstdint>
#include <string>

#include "libacquire/rig_description.h"
#include "libbrdf/error.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    lacquer::acquire::parse_rig(std::string(reinterpret_cast<const char*>(data), size), "fuzz.toml");
  } catch (const lacquer::Error&) {
  }
  return 0;
}
