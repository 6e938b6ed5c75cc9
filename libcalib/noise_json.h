#pragma once

#include <filesystem>
#include <string>

#include "libcalib/noise_model.h"

namespace lacquer::calib {

struct PhotonTransfer;

/// noise.json of `lacquer calibrate noise`: the model, standard errors, figures of each channel, defects and the points of the
/// photon-transfer curve. Units are in the names of the fields.
void write_noise(const std::filesystem::path& file, const PhotonTransfer& transfer, const std::string& provenance_json);

/// The model of a noise.json. Error{file} naming file and field; one measured from dark frames alone has no gain and is refused.
NoiseModel read_noise_model(const std::filesystem::path& file);

}  // namespace lacquer::calib
