#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "libacquire/rig_description.h"
#include "libacquire/toml_reader.h"

/// The parts of parse_rig(), private to libacquire. Each reads some tables of the document `root` into `rig`, in this order:
/// rig, camera, mask, sphere and pose, the rest.
namespace lacquer::acquire::detail {

constexpr double pi = 3.14159265358979323846;
constexpr double metres_per_mm = 1e-3;
constexpr double radians_per_degree = pi / 180;

/// Where files named in the rig file are.
struct RigFiles {
  std::filesystem::path rig_folder;                ///< of the rig file
  std::filesystem::path data_folder;               ///< of photographs, mask and light tables
  std::map<std::string, std::string> copied;       ///< [copied_files]

  std::filesystem::path in_rig_folder(const std::string& as_written) const;
  std::filesystem::path in_data_folder(const std::string& as_written) const;
};

/// [camera] without its pose, and what a frame looks like.
void read_camera(const TomlTable& root, const RigFiles& files, RigDescription& rig);
/// [sphere], pose of the camera in [camera]: either stated, or from the sphere's circle in the image.
void read_sphere_and_pose(const TomlTable& root, RigDescription& rig);
/// [[lights]] or the light tables of [replay].
void read_lights(const TomlTable& root, const RigFiles& files, RigDescription& rig);
/// [plan] and, for photographs, [replay].
void read_plan(const TomlTable& root, const RigFiles& files, RigDescription& rig);
/// Identifiers of the views: L000, R000, D000.
void name_views(std::vector<PlannedView>& plan);
/// [guided], in the place of a plan that was read.
void read_guided(const TomlTable& root, RigDescription& rig);
/// [reference_patch].
void read_reference_patch(const TomlTable& root, RigDescription& rig);

/// [devices] of a rig of kind hardware.
void read_devices(const TomlTable& root, RigDescription& rig);

/// The file exists and is remembered for the session; else an error that names the field.
std::filesystem::path referenced_file(const TomlTable& table, const char* key, const RigFiles& files, RigDescription& rig);

/// [replay], its keys checked.
std::optional<TomlTable> replay_table(const TomlTable& root);

}  // namespace lacquer::acquire::detail
