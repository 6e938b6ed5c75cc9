#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "libacquire/frame.h"
#include "libbrdf/progress.h"
#include "libcalib/exposure_times.h"
#include "libcalib/merge.h"
#include "libcalib/radiance_image.h"
#include "libcalib/response.h"

/// Loose photographs: a list of files with exposure times instead of a session.
namespace lacquer::calib {

struct ListedFrame {
  std::filesystem::path file;  ///< absolute, or relative to the current folder as the list is
  double exposure_s;
  int line;                    ///< in the list, for messages
};

/// CSV with the header `file,exposure_s`, one frame per line; paths are relative to the list; a time is a decimal number or a fraction
/// ("1/1024"), seconds. A byte order mark, CRLF, blank lines and quoted file names are understood. Error{input} "list.csv:7: ...".
std::vector<ListedFrame> read_frame_list(const std::filesystem::path& list);

/// Frame of a list, checked against the first one: Error{input} names list, line and file of one that differs in size or layout.
acquire::RawFrame read_listed_frame(const std::filesystem::path& list, const ListedFrame& listed, int bits,
                                    acquire::PixelLayout single_channel_layout, const acquire::RawFrame* first);

/// All frames of a list in its order.
std::vector<acquire::RawFrame> read_listed_frames(const std::filesystem::path& list, int bits, acquire::PixelLayout single_channel_layout);

/// Every n-th block of 2 x 2 pixels in each direction, so that at most about `max_values` values are left: what response, noise and exposure times
/// are estimated from. The mosaic keeps its phase. A frame with fewer values stays as it is.
acquire::RawFrame thinned(acquire::RawFrame frame, std::size_t max_values = std::size_t{1} << 21);

struct PhotographOptions {
  std::optional<Response> response;       ///< empty: estimated from the frames, unless ...
  bool linear = false;                    ///< ... the sensor is known to be linear
  double black_level_dn = 0;
  double saturation_dn = 0;               ///< 0: 2^bits - 1
  std::optional<double> gain_e_per_dn;    ///< one of the two empty: read, shot and relative noise are estimated from the frames
  std::optional<double> read_noise_e;
  std::optional<NoiseModel> noise;        ///< measured: takes the place of the four above
  SensorMaps maps;
  bool fit_times = false;                 ///< use the times that the pixels say; else false ones are an error
  std::string source = "bracket";         ///< for messages: the list
  std::vector<std::string> names{};       ///< of the frames, for messages
};

/// What the frames say of the camera.
struct PhotographModel {
  Response response;
  std::optional<ResponseEstimate> estimate;  ///< set where the response was estimated
  NoiseModel noise;
  bool noise_estimated = false;
  ExposureTimes times;
};

struct MergedPhotographs : PhotographModel {
  RadianceImage image;
};

/// Response, noise and times of a camera that may be unknown. With an estimated curve and several channels the channels share no scale
/// (see ResponseCurve). Throws Error{input} naming the frames whose listed times are false (unless options.fit_times).
PhotographModel photograph_model(std::span<const acquire::RawFrame> frames, const PhotographOptions& options);

/// photograph_model, then merge_bracket.
MergedPhotographs merge_photographs(const std::vector<acquire::RawFrame>& frames, const PhotographOptions& options);

/// The same for a list, whose files are read twice: thinned for the model, then one by one for the merge. source and names of the options
/// are not used.
MergedPhotographs merge_listed_photographs(const std::filesystem::path& list, int bits, acquire::PixelLayout single_channel_layout,
                                           PhotographOptions options, const Progress& progress = {});

}  // namespace lacquer::calib
