#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "libacquire/frame.h"
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

/// Frames of a list in its order. All must be alike in size and layout: Error{input} names list, line and file of the first that is not.
std::vector<acquire::RawFrame> read_listed_frames(const std::filesystem::path& list, int bits, acquire::PixelLayout single_channel_layout);

struct PhotographOptions {
  std::optional<Response> response;       ///< empty: estimated from the frames
  double black_level_dn = 0;
  double saturation_dn = 0;               ///< 0: 2^bits - 1
  std::optional<double> gain_e_per_dn;    ///< one of the two empty: read, shot and relative noise are estimated from the frames
  std::optional<double> read_noise_e;
};

struct MergedPhotographs {
  RadianceImage image;
  Response response;
  std::optional<ResponseEstimate> estimate;  ///< set where the response was estimated
  NoiseModel noise;
  bool noise_estimated = false;
};

/// Merges photographs of a camera that may be unknown. With an estimated response and several channels the channels share no scale
/// (see ResponseCurve).
MergedPhotographs merge_photographs(const std::vector<acquire::RawFrame>& frames, const PhotographOptions& options);

}  // namespace lacquer::calib
