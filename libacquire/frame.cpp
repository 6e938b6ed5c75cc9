#include "libacquire/frame.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <fstream>
#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <utility>

#include "libacquire/image_header.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::acquire {

namespace {

constexpr std::uint64_t max_file_bytes = std::uint64_t{1} << 30;

constexpr std::array<std::pair<PixelLayout, const char*>, 6> layout_names{{{PixelLayout::mono, "mono"},
                                                                           {PixelLayout::rgb, "rgb"},
                                                                           {PixelLayout::bayer_rggb, "rggb"},
                                                                           {PixelLayout::bayer_grbg, "grbg"},
                                                                           {PixelLayout::bayer_gbrg, "gbrg"},
                                                                           {PixelLayout::bayer_bggr, "bggr"}}};

[[noreturn]] void fail(const std::string& name, const std::string& what) { throw Error(ErrorCode::file, name + ": " + what); }

/// A library does not talk: what OpenCV would print about a bad file becomes our Error. Process-wide, set once.
void silence_opencv() {
  [[maybe_unused]] static const auto previous = cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT);
}

cv::Mat decode(std::span<const std::byte> bytes, const std::string& name) {
  silence_opencv();
  const cv::Mat encoded(1, static_cast<int>(bytes.size()), CV_8U, const_cast<std::byte*>(bytes.data()));  // only read
  cv::Mat image;
  try {
    image = cv::imdecode(encoded, cv::IMREAD_UNCHANGED);
    if (image.channels() == 3) cv::cvtColor(image, image, cv::COLOR_BGR2RGB);
  } catch (const std::exception&) {
    image.release();
  }
  if (image.empty()) fail(name, "image data is damaged and cannot be decoded");
  return image;
}

template <typename T>
void append_rows(const cv::Mat& image, std::vector<std::uint16_t>& data) {
  const std::size_t row_length = static_cast<std::size_t>(image.cols) * static_cast<std::size_t>(image.channels());
  for (int y = 0; y < image.rows; ++y) {
    const T* row = image.ptr<T>(y);
    data.insert(data.end(), row, row + row_length);
  }
}

void check_values(const RawFrame& frame, const std::string& name) {
  unsigned all = 0;
  for (const std::uint16_t v : frame.data) all |= v;
  const unsigned limit = 1u << frame.bits;
  if (all < limit) return;
  const auto bad = std::find_if(frame.data.begin(), frame.data.end(), [&](std::uint16_t v) { return v >= limit; });
  const std::size_t pixel = static_cast<std::size_t>(bad - frame.data.begin()) / static_cast<std::size_t>(values_per_pixel(frame.layout));
  const std::size_t width = static_cast<std::size_t>(frame.width);
  fail(name, fmt::format("pixel ({}, {}) has value {}; expected {} bits, at most {}; are the bits right?", pixel % width, pixel / width,
                         *bad, frame.bits, limit - 1));
}

void check_frame(const RawFrame& frame, const std::string& name) {
  const auto expected = static_cast<std::size_t>(std::max(frame.width, 0)) * static_cast<std::size_t>(std::max(frame.height, 0)) *
                        static_cast<std::size_t>(values_per_pixel(frame.layout));
  if (frame.bits < 8 || frame.bits > 16 || expected == 0 || frame.data.size() != expected)
    throw Error(ErrorCode::usage, fmt::format("{}: cannot write a frame of {} x {} pixels, {} bits with {} values, expected {} values",
                                              name, frame.width, frame.height, frame.bits, frame.data.size(), expected));
  check_values(frame, name);
}

std::vector<unsigned char> encode_tiff(const RawFrame& frame, const std::string& name) {
  silence_opencv();
  const int channels = values_per_pixel(frame.layout);
  std::vector<unsigned char> encoded;
  bool done = false;
  try {
    cv::Mat image(frame.height, frame.width, CV_16UC(channels), const_cast<std::uint16_t*>(frame.data.data()));  // only read
    if (channels == 3) {
      cv::Mat bgr;
      cv::cvtColor(image, bgr, cv::COLOR_RGB2BGR);
      image = bgr;
    }
    if (frame.bits == 8) {
      cv::Mat narrow;
      image.convertTo(narrow, CV_8U);
      image = narrow;
    }
    constexpr int no_compression = 1;  // COMPRESSION_NONE of libtiff
    done = cv::imencode(".tiff", image, encoded, {cv::IMWRITE_TIFF_COMPRESSION, no_compression});
  } catch (const std::exception&) {
    done = false;
  }
  if (!done || encoded.empty()) fail(name, fmt::format("cannot encode a frame of {} x {} pixels as TIFF", frame.width, frame.height));
  return encoded;
}

}  // namespace

PixelLayout pixel_layout_from_name(const std::string& name) {
  for (const auto& [layout, text] : layout_names)
    if (name == text) return layout;
  throw Error(ErrorCode::input, fmt::format("unknown pixel layout \"{}\"; expected mono, rgb, rggb, grbg, gbrg or bggr", name));
}

std::string name_of(PixelLayout layout) {
  for (const auto& [known, text] : layout_names)
    if (known == layout) return text;
  throw Error(ErrorCode::usage, fmt::format("unknown pixel layout {}", static_cast<int>(layout)));
}

int n_channels(PixelLayout layout) { return layout == PixelLayout::mono ? 1 : 3; }

int values_per_pixel(PixelLayout layout) { return layout == PixelLayout::rgb ? 3 : 1; }

int channel_of(PixelLayout layout, int x, int y, int k) {
  if (layout == PixelLayout::mono) return 0;
  if (layout == PixelLayout::rgb) return k;
  // The top left 2 x 2 pixels, row by row, in the order of the names.
  constexpr int pattern[4][4] = {{0, 1, 1, 2}, {1, 0, 2, 1}, {1, 2, 0, 1}, {2, 1, 1, 0}};
  return pattern[static_cast<int>(layout) - static_cast<int>(PixelLayout::bayer_rggb)][(y & 1) * 2 + (x & 1)];
}

RawFrame decode_frame(std::span<const std::byte> bytes, const std::string& name, int bits, PixelLayout single_channel_layout) {
  if (bits < 8 || bits > 16) throw Error(ErrorCode::usage, fmt::format("{}: bits is {}; expected 8 to 16", name, bits));
  if (single_channel_layout == PixelLayout::rgb) single_channel_layout = PixelLayout::mono;
  const ImageHeader header = read_image_header(bytes, name);
  if (header.bits < bits) fail(name, fmt::format("image has {} bits per value; expected a 16-bit file for {}-bit counts", header.bits, bits));

  const cv::Mat image = decode(bytes, name);
  if (image.cols != header.width || image.rows != header.height || image.channels() != header.channels ||
      image.depth() != (header.bits == 8 ? CV_8U : CV_16U))
    fail(name, "image data does not match its header");

  RawFrame frame;
  frame.width = header.width;
  frame.height = header.height;
  frame.bits = bits;
  frame.layout = header.channels == 3 ? PixelLayout::rgb : single_channel_layout;
  frame.data.reserve(static_cast<std::size_t>(header.width) * header.height * header.channels);
  if (header.bits == 8)
    append_rows<std::uint8_t>(image, frame.data);
  else
    append_rows<std::uint16_t>(image, frame.data);
  check_values(frame, name);
  return frame;
}

RawFrame read_frame(const std::string& file, int bits, PixelLayout single_channel_layout) {
  return decode_frame(brdf::read_bytes(file, max_file_bytes), file, bits, single_channel_layout);
}

std::string write_frame(const std::string& file, const RawFrame& frame) {
  check_frame(frame, file);
  const std::vector<unsigned char> encoded = encode_tiff(frame, file);
  brdf::write_atomically(file, [&](const std::filesystem::path& temporary) {
    std::ofstream out(temporary, std::ios::binary);
    out.write(reinterpret_cast<const char*>(encoded.data()), static_cast<std::streamsize>(encoded.size()));
    out.close();
    if (!out) fail(file, "cannot write; is the disk full?");
  });
  return brdf::checksum(std::as_bytes(std::span(encoded)));
}

}  // namespace lacquer::acquire
