#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "libbrdf/brdf.h"
#include "libbrdf/rgl_writer.h"

namespace lacquer::tools {

struct ConvertOptions {
  bool sigma = false;        ///< npy: standard errors too
  brdf::RglOptions rgl;      ///< bsdf
  std::string provenance{};  ///< JSON
};

/// What was written.
struct Converted {
  std::string format;              ///< for people
  std::string judged_by;           ///< how `result` was got, for people
  std::vector<std::string> notes;  ///< what the format cannot hold
  std::unique_ptr<brdf::Brdf> result;  ///< the file as its readers understand it
};

struct ConvertTarget {
  const char* name;       ///< of --format
  const char* extension;  ///< "" for a format that is only chosen by name
  Converted (*write)(const std::filesystem::path& file, const brdf::Brdf& source, const ConvertOptions& options);
};

/// By --format; Error{usage} with the nearest names.
const ConvertTarget& target_named(const std::string& name);
/// By the extension of an output file; Error{usage} with what is understood.
const ConvertTarget& target_of_file(const std::filesystem::path& file);
/// All names, with commas.
std::string target_names();

}  // namespace lacquer::tools
