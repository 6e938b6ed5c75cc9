#include "libacquire/v4l2/v4l2_formats.h"

#include <linux/videodev2.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "libbrdf/error.h"

namespace lacquer::acquire {

namespace {

using L = PixelLayout;
using P = Packing;
using Kind = V4l2Format::Kind;

const std::vector<V4l2Format>& all_formats() {
  static const std::vector<V4l2Format> formats = {
      {V4L2_PIX_FMT_GREY, L::mono, 8, P::bytes},
      {V4L2_PIX_FMT_Y10, L::mono, 10, P::words_le},
      {V4L2_PIX_FMT_Y10P, L::mono, 10, P::mipi_10},
      {V4L2_PIX_FMT_Y12, L::mono, 12, P::words_le},
      {v4l2_fourcc('Y', '1', '2', 'P'), L::mono, 12, P::mipi_12},
      {v4l2_fourcc('Y', '1', '4', ' '), L::mono, 14, P::words_le},
      {V4L2_PIX_FMT_Y16, L::mono, 16, P::words_le},
      {V4L2_PIX_FMT_Y16_BE, L::mono, 16, P::words_be},
      {V4L2_PIX_FMT_SBGGR8, L::bayer_bggr, 8, P::bytes},
      {V4L2_PIX_FMT_SGBRG8, L::bayer_gbrg, 8, P::bytes},
      {V4L2_PIX_FMT_SGRBG8, L::bayer_grbg, 8, P::bytes},
      {V4L2_PIX_FMT_SRGGB8, L::bayer_rggb, 8, P::bytes},
      {V4L2_PIX_FMT_SBGGR10, L::bayer_bggr, 10, P::words_le},
      {V4L2_PIX_FMT_SGBRG10, L::bayer_gbrg, 10, P::words_le},
      {V4L2_PIX_FMT_SGRBG10, L::bayer_grbg, 10, P::words_le},
      {V4L2_PIX_FMT_SRGGB10, L::bayer_rggb, 10, P::words_le},
      {V4L2_PIX_FMT_SBGGR10P, L::bayer_bggr, 10, P::mipi_10},
      {V4L2_PIX_FMT_SGBRG10P, L::bayer_gbrg, 10, P::mipi_10},
      {V4L2_PIX_FMT_SGRBG10P, L::bayer_grbg, 10, P::mipi_10},
      {V4L2_PIX_FMT_SRGGB10P, L::bayer_rggb, 10, P::mipi_10},
      {V4L2_PIX_FMT_SBGGR12, L::bayer_bggr, 12, P::words_le},
      {V4L2_PIX_FMT_SGBRG12, L::bayer_gbrg, 12, P::words_le},
      {V4L2_PIX_FMT_SGRBG12, L::bayer_grbg, 12, P::words_le},
      {V4L2_PIX_FMT_SRGGB12, L::bayer_rggb, 12, P::words_le},
      {V4L2_PIX_FMT_SBGGR12P, L::bayer_bggr, 12, P::mipi_12},
      {V4L2_PIX_FMT_SGBRG12P, L::bayer_gbrg, 12, P::mipi_12},
      {V4L2_PIX_FMT_SGRBG12P, L::bayer_grbg, 12, P::mipi_12},
      {V4L2_PIX_FMT_SRGGB12P, L::bayer_rggb, 12, P::mipi_12},
      {V4L2_PIX_FMT_SBGGR14, L::bayer_bggr, 14, P::words_le},
      {V4L2_PIX_FMT_SGBRG14, L::bayer_gbrg, 14, P::words_le},
      {V4L2_PIX_FMT_SGRBG14, L::bayer_grbg, 14, P::words_le},
      {V4L2_PIX_FMT_SRGGB14, L::bayer_rggb, 14, P::words_le},
      {V4L2_PIX_FMT_SBGGR16, L::bayer_bggr, 16, P::words_le},
      {V4L2_PIX_FMT_SGBRG16, L::bayer_gbrg, 16, P::words_le},
      {V4L2_PIX_FMT_SGRBG16, L::bayer_grbg, 16, P::words_le},
      {V4L2_PIX_FMT_SRGGB16, L::bayer_rggb, 16, P::words_le},
      {V4L2_PIX_FMT_YUYV, L::mono, 8, P::bytes, Kind::yuyv},
      {V4L2_PIX_FMT_YUYV, L::rgb, 8, P::bytes, Kind::yuyv},
      {V4L2_PIX_FMT_MJPEG, L::mono, 8, P::bytes, Kind::mjpeg},
      {V4L2_PIX_FMT_MJPEG, L::rgb, 8, P::bytes, Kind::mjpeg},
  };
  return formats;
}

/// Nearest count of 0..255: colours outside the cube that R, G and B span are moved to its surface, as every viewer does.
std::uint16_t count_of(double v) { return static_cast<std::uint16_t>(std::lround(std::clamp(v, 0.0, 255.0))); }

/// ITU-R BT.601. Two pixels Y0 Cb Y1 Cr share their chroma; it is not interpolated.
void yuyv_to_rgb(const std::uint8_t* line, int width, bool full_range, std::uint16_t* out) {
  const double black = full_range ? 0 : 16, y_scale = full_range ? 1 : 255.0 / 219, c_scale = full_range ? 1 : 255.0 / 224;
  for (int x = 0; x < width; ++x) {
    const std::uint8_t* const pair = line + x / 2 * 4;
    const double y = (pair[x % 2 == 0 ? 0 : 2] - black) * y_scale, cb = (pair[1] - 128) * c_scale, cr = (pair[3] - 128) * c_scale;
    *out++ = count_of(y + 1.402 * cr);
    *out++ = count_of(y - 0.344136 * cb - 0.714136 * cr);
    *out++ = count_of(y + 1.772 * cb);
  }
}

std::optional<std::vector<std::uint16_t>> decode_jpeg(const V4l2Format& format, std::span<const std::uint8_t> bytes, int width, int height) {
  // Not a JPEG at all is told apart before a decoder sees it: other formats of the decoder are no business of a camera.
  if (bytes.size() < 4 || bytes[0] != 0xFF || bytes[1] != 0xD8) return std::nullopt;
  RawFrame frame;
  try {
    frame = decode_frame(std::as_bytes(bytes), "JPEG", 8, PixelLayout::mono);
  } catch (const Error&) {
    return std::nullopt;
  }
  if (frame.width != width || frame.height != height) return std::nullopt;
  if (frame.layout == format.layout) return std::move(frame.data);
  if (format.layout == PixelLayout::rgb) return std::nullopt;  // a grey picture, colour was asked for
  std::vector<std::uint16_t> grey(frame.data.size() / 3);
  for (std::size_t i = 0; i < grey.size(); ++i)
    grey[i] = count_of(0.299 * frame.data[3 * i] + 0.587 * frame.data[3 * i + 1] + 0.114 * frame.data[3 * i + 2]);
  return grey;
}

}  // namespace

std::string fourcc_text(std::uint32_t fourcc) {
  std::string text;
  for (int i = 0; i < 4; ++i) {
    const auto c = static_cast<unsigned char>(fourcc >> (8 * i) & 0x7F);
    text += c >= 0x20 && c < 0x7F ? static_cast<char>(c) : '?';
  }
  return fourcc & 0x80000000u ? text + "-BE" : text;
}

std::vector<V4l2Format> v4l2_formats(PixelLayout layout, int bits, const std::string& name) {
  std::vector<V4l2Format> result;
  for (const V4l2Format& f : all_formats()) {
    std::string text = fourcc_text(f.fourcc);
    while (!text.empty() && text.back() == ' ') text.pop_back();
    if (f.layout == layout && f.bits == bits && (name.empty() || name == text || name == fourcc_text(f.fourcc))) result.push_back(f);
  }
  return result;
}

std::optional<std::vector<std::uint16_t>> decode(const V4l2Format& format, const BufferImage& image, int width, int height) {
  if (format.kind == Kind::mjpeg) return decode_jpeg(format, image.bytes, width, height);
  const auto w = static_cast<std::size_t>(width), h = static_cast<std::size_t>(height);
  const std::size_t line_bytes = format.kind == Kind::yuyv ? (w + 1) / 2 * 4 : packed_bytes(format.packing, w);
  if (h == 0 || image.stride < line_bytes || image.bytes.size() < (h - 1) * image.stride + line_bytes) return std::nullopt;
  std::vector<std::uint16_t> values(w * h * static_cast<std::size_t>(values_per_pixel(format.layout)));
  for (std::size_t y = 0; y < h; ++y) {
    const std::span<const std::uint8_t> line = image.bytes.subspan(y * image.stride, line_bytes);
    if (format.kind == Kind::raw)
      unpack(format.packing, line, std::span(values).subspan(y * w, w));
    else if (format.layout == PixelLayout::mono)
      for (std::size_t x = 0; x < w; ++x) values[y * w + x] = line[2 * x];
    else
      yuyv_to_rgb(line.data(), width, image.full_range, &values[3 * y * w]);
  }
  return values;
}

}  // namespace lacquer::acquire
