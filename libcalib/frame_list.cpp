#include "libcalib/frame_list.h"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <string_view>

#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::calib {

namespace {

constexpr std::size_t max_frames = 4096;

[[noreturn]] void fail(const std::filesystem::path& list, int line, const std::string& what) {
  throw Error(ErrorCode::input, fmt::format("{}:{}: {}", list.string(), line, what));
}

std::string_view trim(std::string_view text) {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  while (!text.empty() && (text.back() == ' ' || text.back() == '\t' || text.back() == '\r')) text.remove_suffix(1);
  return text;
}

std::optional<double> number(std::string_view text) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

/// "0.25" or "1/4".
std::optional<double> seconds(std::string_view text) {
  const std::size_t slash = text.find('/');
  if (slash == std::string_view::npos) return number(text);
  const auto numerator = number(trim(text.substr(0, slash))), denominator = number(trim(text.substr(slash + 1)));
  if (!numerator || !denominator || !(*denominator > 0)) return std::nullopt;
  return *numerator / *denominator;
}

ListedFrame parse_line(const std::filesystem::path& list, int line, std::string_view text) {
  std::string name;
  std::string_view rest;
  if (text.front() == '"') {  // RFC 4180: a doubled quote is a quote
    std::size_t i = 1;
    for (; i < text.size(); ++i) {
      if (text[i] == '"' && (i + 1 >= text.size() || text[i + 1] != '"')) break;
      if (text[i] == '"') ++i;
      name += text[i];
    }
    if (i >= text.size()) fail(list, line, "file: expected a closing quote");
    rest = trim(text.substr(i + 1));
    if (rest.empty() || rest.front() != ',') fail(list, line, "expected 2 columns, file,exposure_s");
    rest.remove_prefix(1);
  } else {
    const std::size_t comma = text.find(',');
    if (comma == std::string_view::npos) fail(list, line, "expected 2 columns, file,exposure_s, got 1");
    name = trim(text.substr(0, comma));
    rest = text.substr(comma + 1);
  }
  rest = trim(rest);
  if (rest.find(',') != std::string_view::npos) fail(list, line, "expected 2 columns, file,exposure_s; quote a file name with a comma");
  if (name.empty()) fail(list, line, "file: expected a file name, got nothing");
  if (name.find('\0') != std::string::npos) fail(list, line, "file: expected a file name, got a zero byte");
  const auto time = seconds(rest);
  if (!time || !(*time > 0) || !std::isfinite(*time))
    fail(list, line, fmt::format("exposure_s: expected a positive number, got \"{}\"", rest));
  if (*time < 1e-9 || *time > 1e6)
    fail(list, line, fmt::format("exposure_s: expected a number of seconds in [1e-9, 1e6], got \"{}\"", rest));
  return {list.parent_path() / name, *time, line};
}

}  // namespace

std::vector<ListedFrame> read_frame_list(const std::filesystem::path& list) {
  const std::string text = brdf::read_text(list, 4u << 20);
  std::string_view rest = text;
  if (rest.substr(0, 3) == "\xEF\xBB\xBF") rest.remove_prefix(3);
  std::vector<ListedFrame> frames;
  bool header_seen = false;
  for (int line = 1; !rest.empty(); ++line) {
    const std::size_t end = std::min(rest.find('\n'), rest.size());
    const std::string_view content = trim(rest.substr(0, end));
    rest.remove_prefix(std::min(end + 1, rest.size()));
    if (content.empty()) continue;
    if (!header_seen) {
      if (content != "file,exposure_s")
        fail(list, line, fmt::format("header: expected \"file,exposure_s\", got \"{}\"", content.substr(0, 80)));
      header_seen = true;
      continue;
    }
    if (frames.size() == max_frames) fail(list, line, fmt::format("expected at most {} frames", max_frames));
    frames.push_back(parse_line(list, line, content));
  }
  if (!header_seen) fail(list, 1, "header: expected \"file,exposure_s\", the file is empty");
  if (frames.empty()) fail(list, 1, "expected at least one frame below the header, got none");
  return frames;
}

std::vector<acquire::RawFrame> read_listed_frames(const std::filesystem::path& list, int bits,
                                                  acquire::PixelLayout single_channel_layout) {
  std::vector<acquire::RawFrame> frames;
  for (const ListedFrame& listed : read_frame_list(list)) {
    acquire::RawFrame frame = acquire::read_frame(listed.file.string(), bits, single_channel_layout);
    frame.actual = {listed.exposure_s, 0};
    if (!frames.empty() && (frame.width != frames[0].width || frame.height != frames[0].height || frame.layout != frames[0].layout))
      fail(list, listed.line,
           fmt::format("file: {} is {} x {} {}, expected {} x {} {} as the first frame", listed.file.string(), frame.width, frame.height,
                       acquire::name_of(frame.layout), frames[0].width, frames[0].height, acquire::name_of(frames[0].layout)));
    frames.push_back(std::move(frame));
  }
  return frames;
}

MergedPhotographs merge_photographs(const std::vector<acquire::RawFrame>& frames, const PhotographOptions& options) {
  MergedPhotographs merged;
  merged.noise.black_level_dn = options.black_level_dn;
  merged.noise.saturation_dn = options.saturation_dn;
  const std::vector<std::vector<acquire::RawFrame>> brackets{frames};
  if (options.response) {
    merged.response = *options.response;
  } else {
    ResponseOptions response_options;
    response_options.black_level_dn = options.black_level_dn;
    response_options.saturation_dn = options.saturation_dn;
    merged.estimate = estimate_response(brackets, response_options);
    merged.response = merged.estimate->response;
  }
  if (options.gain_e_per_dn && options.read_noise_e) {
    merged.noise.gain_e_per_dn = *options.gain_e_per_dn;
    merged.noise.read_noise_e = *options.read_noise_e;
  } else {
    merged.noise = estimate_noise(brackets, merged.response, merged.noise);
    merged.noise_estimated = true;
    if (options.gain_e_per_dn) merged.noise.gain_e_per_dn = *options.gain_e_per_dn;
    if (options.read_noise_e) merged.noise.read_noise_e = *options.read_noise_e;
  }
  merged.image = merge_bracket(frames, merged.response, merged.noise);
  return merged;
}

}  // namespace lacquer::calib
