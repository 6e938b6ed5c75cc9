#include <cstddef>
#include <cstdint>

#include "libacquire/image_header.h"
#include "libbrdf/error.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  try {
    lacquer::acquire::read_image_header(std::as_bytes(std::span(data, size)), "fuzz");
  } catch (const lacquer::Error&) {
  }
  return 0;
}
