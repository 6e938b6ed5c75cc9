#include "libcalib/frame_list.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <numeric>
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

acquire::RawFrame read_listed_frame(const std::filesystem::path& list, const ListedFrame& listed, int bits,
                                    acquire::PixelLayout single_channel_layout, const acquire::RawFrame* first) {
  acquire::RawFrame frame = acquire::read_frame(listed.file.string(), bits, single_channel_layout);
  frame.actual = {listed.exposure_s, 0};
  if (first && (frame.width != first->width || frame.height != first->height || frame.layout != first->layout))
    fail(list, listed.line,
         fmt::format("file: {} is {} x {} {}, expected {} x {} {} as the first frame", listed.file.string(), frame.width, frame.height,
                     acquire::name_of(frame.layout), first->width, first->height, acquire::name_of(first->layout)));
  return frame;
}

std::vector<acquire::RawFrame> read_listed_frames(const std::filesystem::path& list, int bits,
                                                  acquire::PixelLayout single_channel_layout) {
  std::vector<acquire::RawFrame> frames;
  for (const ListedFrame& listed : read_frame_list(list))
    frames.push_back(read_listed_frame(list, listed, bits, single_channel_layout, frames.empty() ? nullptr : &frames.front()));
  return frames;
}

acquire::RawFrame thinned(acquire::RawFrame frame, std::size_t max_values) {
  const auto step = static_cast<int>(std::ceil(std::sqrt(static_cast<double>(frame.data.size()) / static_cast<double>(max_values))));
  const int blocks_x = frame.width / 2, blocks_y = frame.height / 2;
  if (step <= 1 || blocks_x < step || blocks_y < step) return frame;
  const auto per_pixel = static_cast<std::size_t>(acquire::values_per_pixel(frame.layout)), width = static_cast<std::size_t>(frame.width);
  acquire::RawFrame thin{2 * (blocks_x / step), 2 * (blocks_y / step), frame.layout, frame.bits, {}, frame.actual};
  thin.data.reserve(static_cast<std::size_t>(thin.width) * static_cast<std::size_t>(thin.height) * per_pixel);
  for (int y = 0; y < thin.height; ++y) {
    const auto row = static_cast<std::size_t>(y / 2 * 2 * step + y % 2) * width;
    for (int x = 0; x < thin.width; x += 2) {
      const auto* block = &frame.data[(row + static_cast<std::size_t>(x * step)) * per_pixel];
      thin.data.insert(thin.data.end(), block, block + 2 * per_pixel);
    }
  }
  return thin;
}

PhotographModel photograph_model(std::span<const acquire::RawFrame> given, const PhotographOptions& options) {
  PhotographModel model;
  model.noise = options.noise.value_or(NoiseModel{.black_level_dn = options.black_level_dn, .saturation_dn = options.saturation_dn});
  std::vector<std::vector<acquire::RawFrame>> brackets{{given.begin(), given.end()}};
  std::vector<acquire::RawFrame>& frames = brackets.front();
  if (options.response || options.linear) {
    model.response = options.response ? *options.response
                                      : linear_response(frames.front().bits, acquire::n_channels(frames.front().layout), model.noise.black_level_dn);
    model.times = check_exposure_times(frames, model.response, model.noise);
  } else {
    ResponseOptions response_options;
    response_options.black_level_dn = model.noise.black_level_dn;
    response_options.saturation_dn = model.noise.saturation_dn;
    model.estimate = estimate_response(brackets, response_options);
    model.response = model.estimate->response;
    model.times = exposure_times(brackets, 0, *model.estimate);
  }
  if (options.fit_times)
    use_fitted_times(model.times, frames);
  else
    refuse_false_times(model.times, options.source, options.names);
  if (options.noise) return model;
  if (!options.gain_e_per_dn || !options.read_noise_e) {
    model.noise = estimate_noise(brackets, model.response, model.noise);
    model.noise_estimated = true;
  }
  if (options.gain_e_per_dn) model.noise.gain_e_per_dn = *options.gain_e_per_dn;
  if (options.read_noise_e) model.noise.read_noise_e = *options.read_noise_e;
  return model;
}

MergedPhotographs merge_photographs(const std::vector<acquire::RawFrame>& given, const PhotographOptions& options) {
  MergedPhotographs merged{photograph_model(given, options), {}};
  if (!options.fit_times) {
    merged.image = merge_bracket(given, merged.response, merged.noise, options.maps);
    return merged;
  }
  std::vector<acquire::RawFrame> frames = given;
  use_fitted_times(merged.times, frames);
  merged.image = merge_bracket(frames, merged.response, merged.noise, options.maps);
  return merged;
}

MergedPhotographs merge_listed_photographs(const std::filesystem::path& list, int bits, acquire::PixelLayout single_channel_layout,
                                           PhotographOptions options, const Progress& progress) {
  const std::vector<ListedFrame> listed = read_frame_list(list);
  options.source = list.string();
  options.names.clear();
  const auto report = [&](const char* stage, std::size_t done) {
    if (progress) progress(stage, done, listed.size());
  };
  std::vector<acquire::RawFrame> thin;
  acquire::RawFrame format;  // of the first frame, without data
  for (const ListedFrame& l : listed) {
    options.names.push_back(l.file.filename().string());
    acquire::RawFrame frame = read_listed_frame(list, l, bits, single_channel_layout, thin.empty() ? nullptr : &format);
    if (thin.empty()) format = {frame.width, frame.height, frame.layout, frame.bits, {}, frame.actual};
    thin.push_back(thinned(std::move(frame)));
    report("sample", thin.size());
  }
  MergedPhotographs merged{photograph_model(thin, options), {}};
  thin = {};

  std::vector<std::size_t> order(listed.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  const std::vector<double>& times = options.fit_times ? merged.times.fitted_s : merged.times.listed_s;
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return times[a] < times[b]; });
  BracketMerger merger(merged.response, merged.noise, times, options.maps);
  for (std::size_t k = 0; k < order.size(); ++k) {
    acquire::RawFrame frame = read_listed_frame(list, listed[order[k]], bits, single_channel_layout, &format);
    frame.actual.exposure_s = times[order[k]];
    merger.add(frame);
    report("merge", k + 1);
  }
  merged.image = merger.finish();
  return merged;
}

}  // namespace lacquer::calib
