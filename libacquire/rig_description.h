#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "libacquire/device_settings.h"
#include "libacquire/frame.h"
#include "libacquire/lens_file.h"
#include "libacquire/rig_geometry.h"

namespace lacquer::acquire {

/// Sensor as the data sheet states it (nominal), all channels alike but for sensitivity.
struct SensorDescription {
  PixelLayout layout = PixelLayout::mono;
  int bits = 12;                            ///< 8..16
  double black_level_dn = 0;                ///< offset added by the camera, DN
  double gain_e_per_dn = 1;                 ///< electrons per DN
  double read_noise_e = 2;                  ///< RMS electrons, quantisation not included
  double full_well_e = 0;                   ///< electrons; 0: the ADC clips first
  double dark_current_e_per_s = 0;
  glm::dvec3 sensitivity{1.0};              ///< electrons per second and W m^-2 sr^-1, per channel R G B (mono: the first)
  double vignetting = 0;                    ///< fraction lost at the image corner: transmission 1 - v (rho/rho_corner)^2
  double lens_blur_px = 0;                  ///< sigma of the lens blur as measured, pixels
  enum class Response { linear, gamma, estimate } response = Response::linear;
  double gamma = 1;                         ///< response gamma: DN = max * (linear fraction)^(1/gamma); simulated rig only
  std::optional<std::filesystem::path> noise_file;  ///< of lacquer calibrate noise: measured, takes the place of the nominal noise
  std::optional<std::filesystem::path> maps_file;   ///< of the same: offset, dark signal, flat field and bad values
};

/// What the photographs of a view are for.
enum class ViewKind {
  measurement,
  reference,  ///< a measurement view taken again, to see what the light does with time
  dark        ///< all lights off
};

std::string name_of(ViewKind kind);  ///< "measurement", "reference", "dark"

/// One position of the turntable with one light on, or none.
struct PlannedView {
  double turntable_angle = 0;        ///< radians
  int light = 0;                     ///< index into geometry.lights; -1: dark
  std::vector<double> exposures_s;   ///< ascending
  std::vector<std::filesystem::path> files;  ///< replay: one per exposure, absolute
  ViewKind kind = ViewKind::measurement;
  std::string id{};                  ///< "L012": each kind is counted on its own, references R000, dark views D000
};

/// How the values of a simulated sensor differ from each other; always the same for a seed.
struct SensorFlaws {
  double prnu = 0;                ///< relative RMS of the sensitivity, normal, same for a value in every frame
  double dsnu_e = 0;              ///< RMS electrons of a fixed offset, normal
  double dark_nonuniformity = 0;  ///< relative RMS of the dark current, log-normal with the nominal mean
  double hot_pixels = 0;          ///< fraction of values with 300 to 3000 times the dark current (of 1 e-/s at least)
  double dead_pixels = 0;         ///< fraction of values that do not see light
};

/// What the simulated rig does differently from the description: the truth, never seen by the pipeline.
struct SimulationDescription {
  std::filesystem::path paint;            ///< default paint (any BRDF file)
  std::uint64_t seed = 1;
  double axis_tilt_x = 0, axis_tilt_z = 0;   ///< radians, true axis against nominal
  glm::dvec3 axis_offset{0.0};               ///< metres
  double step_error_rms = 0;                 ///< radians, true angle against read-back angle
  double readback_noise_rms = 0;             ///< radians
  double led_drift_per_hour = 0;             ///< fraction, exponential warm-up drift
  double led_noise_rms = 0;                  ///< fraction, frame to frame
  double patch_radiance = 0;                 ///< W m^-2 sr^-1 of the reference patch, before the LED's drift and noise; 0: there is none
  double stray_light = 0;                    ///< fraction of the image's mean radiance added everywhere
  double blur_px = 0;                        ///< sigma of the lens blur, pixels
  glm::dvec3 sphere_offset{0.0};             ///< metres, true sphere centre against nominal
  glm::dvec3 light_factor{1.0};              ///< true intensity of every light over the stated one, per channel
  std::optional<double> falloff_exponent;    ///< true one of every near light; nullopt: as stated
  SensorFlaws sensor{};
};

/// Which surface points may be used: part of the rig, not of the code.
struct MaskDescription {
  std::optional<std::filesystem::path> file;  ///< 8-bit image, 0 = not paint
  std::optional<double> min_y;                ///< metres, rig frame: the paper's upper half-sphere is 0
};

/// A file that is needed to understand a rig file (mask, light tables) and therefore goes into the session with it.
struct ReferencedFile {
  std::string as_written;          ///< in the rig file
  std::filesystem::path resolved;
};

/// A rig file (TOML), checked: every number finite and in range, unknown keys are errors that name the nearest known key.
struct RigDescription {
  enum class Kind { simulated, replay, hardware } kind = Kind::simulated;
  std::string name;
  std::filesystem::path file;     ///< where it was read from; relative paths in it are relative to its folder
  std::string text;               ///< the file's content, copied into the session
  RigGeometry geometry;           ///< nominal
  std::optional<Lens> lens;       ///< of camera.lens_file, which geometry.camera then follows; with its covariance, where the file says it
  SensorDescription sensor;
  MaskDescription mask;
  std::vector<PlannedView> plan;
  std::optional<double> adaptive_loss;  ///< each view takes only the exposures it needs: largest mean loss of sigma, relative; nullopt: all of them
  bool guided = false;            ///< the plan is that of a guided capture (guided_plan.h), not one of a measurement
  std::optional<PixelRectangle> reference_patch;  ///< a white patch beside the sphere that sees each light alike in every view
  SimulationDescription simulation;
  DevicesDescription devices;     ///< of a rig of kind hardware
  std::vector<ReferencedFile> referenced_files;  ///< each once
  bool absolute_scale = true;     ///< light intensities and sensitivity are calibrated: f_r comes out in 1/sr
};

/// Reads and checks a rig file; rigs/README.md lists every key with unit and default. Photographs and paints are not opened, masks and
/// light tables are. `data_folder`, if given, takes the place of the rig file's replay.folder. Throws Error{file}: file, field, what was
/// expected; for a syntax error the line.
RigDescription read_rig(const std::filesystem::path& file, const std::filesystem::path& data_folder = {});
/// The same from text; `file` is used for messages and relative paths.
RigDescription parse_rig(const std::string& text, const std::filesystem::path& file, const std::filesystem::path& data_folder = {});

/// Text of a rig file for another folder: table [copied_files] at its end says where the files it refers to are now. `copies`: as
/// written -> relative to the new place of the rig file. A table of an earlier copy is replaced.
std::string with_copied_files(const std::string& text, const std::vector<std::pair<std::string, std::string>>& copies);

}  // namespace lacquer::acquire
