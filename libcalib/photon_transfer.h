#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "libacquire/frame.h"
#include "libbrdf/progress.h"
#include "libcalib/noise_model.h"
#include "libcalib/response.h"
#include "libcalib/sensor_maps.h"

/// Photon transfer: the noise model of a sensor from dark frames and pairs of flat frames (Janesick, "Photon Transfer", 2007;
/// EMVA 1288 release 4.0, sections 6 to 8). All on LINEARISED values: raw DN of a linear sensor, exposures of a curved one.
namespace lacquer::calib {

/// A number with its standard error.
struct Measured {
  double value = 0;
  double sigma = 0;
};

/// Frames read one at a time, some of them more than once, so that memory does not grow with their number.
struct FrameSeries {
  struct Item {
    double exposure_s;
    std::string name;  ///< for messages: "darks.csv:4: dark_03.tiff"
  };
  std::vector<Item> items;
  std::function<acquire::RawFrame(std::size_t)> read;
};

/// Frames of a list (see read_frame_list), read when they are asked for.
FrameSeries listed_series(const std::filesystem::path& list, int bits, acquire::PixelLayout single_channel_layout);

struct PhotonTransferOptions {
  /// Curve of a sensor that is not linear; empty or linear: raw DN are taken as they are.
  std::optional<Response> response;
  /// Used where there are no dark frames (required then) or where they are clipped at 0.
  std::optional<double> black_level_dn;
  double saturation_dn = 0;  ///< raw values >= this are clipped; 0: found from the flats, else 2^bits - 1
  /// What becomes of the smooth part of the flats. removed: divided out as a polynomial of degree 6 per channel, since it is lamp and
  /// lens, not sensor; vignetting stays where the rig describes it (sensor.vignetting). kept: the flats saw a uniform source through the
  /// lens that will be used; the map then contains the vignetting and sensor.vignetting must be 0.
  enum class Shading { removed, kept } shading = Shading::removed;
  double hot_sigmas = 8;     ///< dark rate further than this from the median, in robust standard deviations, is hot
  double erratic_ratio = 3;  ///< temporal noise more than this times what the model says is erratic (random telegraph noise)
};

/// One pair of frames of one channel: a point of the photon-transfer curve.
struct TransferPoint {
  enum class Use {
    fitted,
    clipped,       ///< values reach the top of the range
    variance_drop, ///< variance falls below the line: full well
    quantised      ///< noise too small against rounding: the 1/12 of a DN^2 does not hold (EMVA 1288, 6.6)
  };
  int channel = 0;
  bool dark = false;
  double exposure_s = 0;
  double mean = 0;          ///< signal above black, light and dark current, linearised DN
  double light = 0;         ///< the part of `mean` that is light
  double light_square = 0;  ///< mean square of the light over the frame, DN^2, free of noise
  double variance = 0;      ///< temporal, DN^2, quantisation removed
  double sigma = 0;         ///< standard error of `variance`
  double quantisation = 0;  ///< what was removed, DN^2
  double n_values = 0;
  Use use = Use::fitted;
};

/// What was measured of one channel, or of all together. Empty: the frames do not say.
struct NoiseFigures {
  std::optional<Measured> black_level_dn;        ///< raw DN at exposure time 0
  std::optional<Measured> gain_e_per_dn;
  std::optional<Measured> read_noise_dn;         ///< RMS, linearised DN, quantisation removed
  std::optional<Measured> read_noise_e;
  std::optional<Measured> dark_current_dn_per_s; ///< mean over the values that are not bad
  std::optional<Measured> dark_current_e_per_s;
  std::optional<Measured> relative_noise;        ///< RMS fraction of the signal per value and frame; empty: not significant
  std::optional<Measured> dsnu_dn;               ///< RMS of the fixed pattern at exposure time 0, its own noise removed
  std::optional<Measured> dark_spread_dn_per_s;  ///< RMS over the values of the dark rate, its own noise removed
  std::optional<Measured> prnu;                  ///< RMS of the sensitivity relative to its mean, its own noise removed
  double noise_correlation = 0;                  ///< of temporal noise between neighbours of one channel; 0 for raw data
  double chi_square = 0;                         ///< of the photon-transfer line
  int degrees_of_freedom = 0;
};

struct PhotonTransfer {
  int width = 0, height = 0, bits = 0;
  acquire::PixelLayout layout = acquire::PixelLayout::mono;
  NoiseModel model;             ///< one for all channels; gain 1 where it was not measured
  bool gain_measured = false;
  NoiseFigures all;
  std::vector<NoiseFigures> channels;
  double one_gain_chi_square = 0;  ///< of the hypothesis that all channels have the same gain, channels - 1 degrees of freedom
  std::optional<Measured> full_well_e;   ///< from the level where the variance drops; empty: not reached
  std::optional<Measured> lamp_flicker;  ///< RMS fraction by which the mean of a flat changes from frame to frame
  std::vector<TransferPoint> points;
  SensorMaps maps;              ///< a map that is no better than none (its noise exceeds what it corrects) is left out
  std::size_t n_hot = 0, n_dead = 0, n_erratic = 0;
  std::vector<std::string> notes;  ///< what could not be measured and what to do about it, one line each
};

/// `darks`: lens covered, at one or more exposure times, best two or more frames at each of three or more. `flats`: evenly lit, frames of
/// equal exposure and lamp in pairs that follow each other, best at ten or more levels up to saturation. Either may be empty.
/// Throws Error{input} naming the frame whose size, layout, bits or gain differs, or what is missing.
PhotonTransfer photon_transfer(const FrameSeries& darks, const FrameSeries& flats, const PhotonTransferOptions& options,
                               const Progress& progress = {});

}  // namespace lacquer::calib
