#include "tools/convert_targets.h"

#include <fmt/format.h>

#include <array>
#include <nlohmann/json.hpp>
#include <optional>

#include "libbrdf/brdf_explorer.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libbrdf/mbsdf.h"
#include "libbrdf/renderer_materials.h"
#include "libbrdf/table_files.h"
#include "libfit/material_refit.h"

namespace lacquer::tools {

namespace {

using Path = std::filesystem::path;
constexpr const char* read_back = "file as read back";

/// Provenance with the source's own inside, and what kind of thing it was.
std::string provenance_of(const brdf::Brdf& source, const ConvertOptions& options) {
  auto json = nlohmann::ordered_json::parse(options.provenance);
  json["source"] = source.description();
  if (const auto* table = dynamic_cast<const brdf::TableBrdf*>(&source)) json["source_provenance"] = table->table().provenance_json;
  return json.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

/// The source's own table, or the source tabulated at the cells' centres, averaged over both directions.
brdf::HalfAngleTable table_of(const brdf::Brdf& source, const ConvertOptions& options, std::vector<std::string>& notes) {
  std::optional<brdf::HalfAngleTable> table;
  if (const auto* own = dynamic_cast<const brdf::TableBrdf*>(&source)) {
    table = own->table();
  } else {
    table = brdf::tabulate_brdf(brdf::ReciprocalMean(source));
    notes.push_back("tabulated at the cells' centres; the two directions averaged (a cell holds both)");
  }
  table->provenance_json = provenance_of(source, options);
  if (!table->absolute_scale) notes.push_back("the scale is relative: no reference of known reflectance was used");
  return std::move(*table);
}

Converted written(const Path& file, std::string format, std::vector<std::string> notes) {
  return {std::move(format), read_back, std::move(notes), brdf::load_brdf(file)};
}

Converted write_table(const Path& file, const brdf::Brdf& source, const ConvertOptions& options) {
  std::vector<std::string> notes;
  brdf::write_table(file, table_of(source, options, notes));
  return written(file, "table of Lacquer, OpenEXR", std::move(notes));
}

Converted write_merl(const Path& file, const brdf::Brdf& source, const ConvertOptions& options) {
  std::vector<std::string> notes;
  const brdf::HalfAngleTable table = table_of(source, options, notes);
  brdf::write_merl(file, table);
  brdf::write_side_file(file, table, "MERL .binary, 90 x 90 x 180, value at the cell's centre, -1: no value");
  notes.push_back("lost: variances, counts, mean coordinates, which cells are filled; negative cells become -1");
  notes.push_back("scale and provenance are in " + file.filename().string() + ".json");
  return written(file, "MERL .binary", std::move(notes));
}

Converted write_csv(const Path& file, const brdf::Brdf& source, const ConvertOptions& options) {
  std::vector<std::string> notes;
  brdf::write_table_csv(file, table_of(source, options, notes));
  notes.push_back("lost: mean coordinates and footprints");
  return written(file, "CSV, one row per cell", std::move(notes));
}

Converted write_npy(const Path& file, const brdf::Brdf& source, const ConvertOptions& options) {
  std::vector<std::string> notes;
  brdf::write_table_npy(file, table_of(source, options, notes), options.sigma);
  notes.push_back("lost: counts, origins, mean coordinates and footprints" + std::string(options.sigma ? "" : ", variances (--sigma keeps them)"));
  notes.push_back("scale and provenance are in " + file.filename().string() + ".json");
  return written(file, "NumPy array", std::move(notes));
}

/// For the text that a format carries: source, unit, scale, colour space, provenance.
std::string description_of(const brdf::Brdf& source, const ConvertOptions& options) {
  bool absolute = true;
  if (const auto* table = dynamic_cast<const brdf::TableBrdf*>(&source)) absolute = table->table().absolute_scale;
  return fmt::format("{}; f_r in 1/sr, scale {}; colour space as the source (camera RGB unless it says that it was converted); {}",
                     source.description(), absolute ? "absolute" : "relative", provenance_of(source, options));
}

Converted write_tensor(const Path& file, const brdf::Brdf& source, const ConvertOptions& options, bool spectral) {
  brdf::RglOptions rgl = options.rgl;
  rgl.spectral = spectral;
  std::vector<std::string> notes;
  rgl.description = description_of(source, options);
  brdf::write_rgl(file, source, rgl);
  notes.push_back(fmt::format("{} incident angles, {} x {} values each", rgl.n_theta_i, rgl.resolution, rgl.resolution));
  if (spectral) notes.push_back("spectra are smooth curves with the source's RGB, not measured ones");
  return written(file, spectral ? "RGL .bsdf, spectral" : "RGL .bsdf, RGB", std::move(notes));
}
Converted write_rgl(const Path& file, const brdf::Brdf& source, const ConvertOptions& options) { return write_tensor(file, source, options, false); }
Converted write_rgl_spectral(const Path& file, const brdf::Brdf& source, const ConvertOptions& options) {
  return write_tensor(file, source, options, true);
}

Converted write_mbsdf(const Path& file, const brdf::Brdf& source, const ConvertOptions& options) {
  brdf::MbsdfOptions mbsdf;
  mbsdf.description = description_of(source, options);
  brdf::write_mbsdf(file, source, mbsdf);
  return written(file, "NVIDIA .mbsdf, RGB", {"a uniform grid of 1 degree cells holds no narrower highlight: use it for the base below an analytic clear coat"});
}

/// The analytic model, or Error{input}: the formats below hold parameters.
const brdf::CookTorrance& model_of(const brdf::Brdf& source) {
  if (const auto* model = dynamic_cast<const brdf::CookTorranceBrdf*>(&source)) return model->model();
  throw Error(ErrorCode::input, source.description() + ": this format holds a model's parameters; fit the table first (lacquer fit) and convert the fit.json");
}

Converted write_brdf_explorer(const Path& file, const brdf::Brdf& source, const ConvertOptions& options) {
  const brdf::CookTorrance& model = model_of(source);
  brdf::write_text_atomically(file, brdf::brdf_explorer_text(model, description_of(source, options)));
  return {"BRDF Explorer .brdf, GLSL", "parameters as read back, the same model", {},
          std::make_unique<brdf::CookTorranceBrdf>(brdf::brdf_explorer_model(brdf::read_text(file), file.string()))};
}

/// A renderer's material with the parameters that come nearest to the source's model.
template <typename Material>
Converted write_material(const Path& file, const brdf::Brdf& source, const ConvertOptions& options, Material (*refit)(const brdf::CookTorrance&),
                         const std::string& format, std::vector<std::string> notes) {
  const Material material = refit(model_of(source));
  brdf::write_text_atomically(file, material.text("paint", description_of(source, options)));
  notes.insert(notes.begin(), "refitted: the renderer's lobes have another shape than the model's");
  return {format, "the renderer's published formula with the refitted parameters", std::move(notes),
          std::make_unique<brdf::MaterialBrdf<Material>>(material, format)};
}

Converted write_luxcore(const Path& file, const brdf::Brdf& source, const ConvertOptions& options) {
  return write_material(file, source, options, fit::refit_luxcore, "LuxCore carpaint properties", {});
}
Converted write_gltf(const Path& file, const brdf::Brdf& source, const ConvertOptions& options) {
  return write_material(file, source, options, fit::refit_gltf, "glTF 2.0 with KHR_materials_clearcoat", {"one base lobe, coat of IOR 1.5; colours count as linear sRGB"});
}
Converted write_open_pbr(const Path& file, const brdf::Brdf& source, const ConvertOptions& options) {
  return write_material(file, source, options, fit::refit_open_pbr, "MaterialX open_pbr_surface", {"one base lobe; colours count as linear Rec. 709"});
}

constexpr std::array<ConvertTarget, 11> targets{{
    {"exr", ".exr", write_table},
    {"merl", ".binary", write_merl},
    {"bsdf", ".bsdf", write_rgl},
    {"bsdf-spectral", "", write_rgl_spectral},
    {"npy", ".npy", write_npy},
    {"csv", ".csv", write_csv},
    {"mbsdf", ".mbsdf", write_mbsdf},
    {"brdf", ".brdf", write_brdf_explorer},
    {"luxcore", ".scn", write_luxcore},
    {"gltf", ".gltf", write_gltf},
    {"openpbr", ".mtlx", write_open_pbr},
}};

}  // namespace

std::string target_names() {
  std::string names;
  for (const auto& target : targets) names += (names.empty() ? "" : ", ") + std::string(target.name);
  return names;
}

const ConvertTarget& target_named(const std::string& name) {
  for (const auto& target : targets)
    if (name == target.name) return target;
  throw Error(ErrorCode::usage, fmt::format("--format: expected one of {}; got '{}'", target_names(), name));
}

const ConvertTarget& target_of_file(const Path& file) {
  const std::string extension = file.extension().string();
  std::string understood;
  for (const auto& target : targets) {
    if (*target.extension == '\0') continue;
    if (extension == target.extension) return target;
    understood += (understood.empty() ? "" : ", ") + std::string(target.extension);
  }
  throw Error(ErrorCode::usage, fmt::format("{}: cannot tell the format from the extension '{}'; expected one of {}, or give --format", file.string(),
                                            extension, understood));
}

}  // namespace lacquer::tools
