#include "bench/radiometry/exr_compression.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <ImfThreading.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <thread>

namespace lacquer::bench {

namespace {

struct Planes {
  std::vector<float> radiance, variance;
  std::vector<unsigned> flags;
};

constexpr std::array<const char*, 3> names{"R", "G", "B"};

Imf::FrameBuffer frame_buffer(Planes& planes, int width) {
  Imf::FrameBuffer buffer;
  for (std::size_t k = 0; k < names.size(); ++k) {
    const auto slice = [&](Imf::PixelType type, void* base) {
      return Imf::Slice(type, static_cast<char*>(base), 12, 12 * static_cast<std::size_t>(width));
    };
    buffer.insert(names[k], slice(Imf::FLOAT, &planes.radiance[k]));
    buffer.insert(std::string(names[k]) + ".variance", slice(Imf::FLOAT, &planes.variance[k]));
    buffer.insert(std::string(names[k]) + ".flag", slice(Imf::UINT, &planes.flags[k]));
  }
  return buffer;
}

}  // namespace

std::vector<CompressionResult> measure_compressions(const calib::RadianceImage& image, const std::filesystem::path& folder, int repeats) {
  struct Compression {
    const char* name;
    Imf::Compression id;
    bool lossy;
  };
  constexpr std::array<Compression, 8> compressions{{{"none", Imf::NO_COMPRESSION, false},
                                                     {"RLE", Imf::RLE_COMPRESSION, false},
                                                     {"ZIPS", Imf::ZIPS_COMPRESSION, false},
                                                     {"ZIP", Imf::ZIP_COMPRESSION, false},
                                                     {"PIZ", Imf::PIZ_COMPRESSION, false},
                                                     {"PXR24", Imf::PXR24_COMPRESSION, true},
                                                     {"DWAA", Imf::DWAA_COMPRESSION, true},
                                                     {"DWAB", Imf::DWAB_COMPRESSION, true}}};
  Imf::setGlobalThreadCount(static_cast<int>(std::thread::hardware_concurrency()));
  Planes out{image.radiance, image.variance, {}}, in = out;
  std::transform(image.flags.begin(), image.flags.end(), std::back_inserter(out.flags), [](auto f) { return static_cast<unsigned>(f); });
  in.flags = out.flags;
  std::vector<CompressionResult> results;
  for (const Compression& c : compressions) {
    const std::string file = (folder / "compression.exr").string();
    Imf::Header header(image.width, image.height, 1, Imath::V2f(0, 0), 1, Imf::INCREASING_Y, c.id);
    for (const char* name : names) {
      header.channels().insert(name, Imf::Channel(Imf::FLOAT));
      header.channels().insert(std::string(name) + ".variance", Imf::Channel(Imf::FLOAT));
      header.channels().insert(std::string(name) + ".flag", Imf::Channel(Imf::UINT));
    }
    CompressionResult result{c.name, c.lossy, {}, {}, 0, 0};
    result.write = time_repeats(repeats, [&] {
      Imf::OutputFile exr(file.c_str(), header);
      exr.setFrameBuffer(frame_buffer(out, image.width));
      exr.writePixels(image.height);
    });
    result.read = time_repeats(repeats, [&] {
      Imf::InputFile exr(file.c_str());
      exr.setFrameBuffer(frame_buffer(in, image.width));
      exr.readPixels(0, image.height - 1);
    });
    result.megabytes = static_cast<double>(std::filesystem::file_size(file)) / 1e6;
    for (std::size_t i = 0; i < in.radiance.size(); ++i)
      result.largest_change =
          std::max(result.largest_change, std::abs(static_cast<double>(in.radiance[i]) - out.radiance[i]) / std::sqrt(static_cast<double>(out.variance[i])));
    results.push_back(result);
  }
  return results;
}

}  // namespace lacquer::bench
