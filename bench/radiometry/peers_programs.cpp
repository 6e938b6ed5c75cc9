#include <fmt/format.h>
#include <sys/wait.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <opencv2/core/version.hpp>

#include "bench/radiometry/peers.h"
#include "libbrdf/error.h"
#include "libbrdf/files.h"

namespace lacquer::bench {

namespace {

/// Runs a shell command in `folder`; what it says goes to `log` there. True when it ends with 0.
bool shell(const std::filesystem::path& folder, const std::string& command, const std::string& log) {
  const int status = std::system(fmt::format("cd '{}' && ( set -e; {} ) >{} 2>&1 </dev/null", folder.string(), command, log).c_str());
  return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

bool installed(const std::string& program) { return std::system(("command -v " + program + " >/dev/null 2>&1").c_str()) == 0; }

/// PFM: "PF", width height, scale (negative: little endian), rows from bottom to top.
std::vector<float> read_pfm(const std::filesystem::path& file, int width, int height) {
  std::ifstream in(file, std::ios::binary);
  std::string magic;
  int w = 0, h = 0;
  double scale = 0;
  in >> magic >> w >> h >> scale;
  in.get();
  if (!in || magic != "PF" || w != width || h != height || !(scale < 0))
    throw Error(ErrorCode::file, fmt::format("{}: expected a colour PFM of {} x {}, little endian", file.string(), width, height));
  const std::size_t row = static_cast<std::size_t>(width) * 3;
  std::vector<float> pixels(row * static_cast<std::size_t>(height));
  for (std::size_t y = static_cast<std::size_t>(height); y-- > 0;)
    in.read(reinterpret_cast<char*>(&pixels[y * row]), static_cast<std::streamsize>(row * sizeof(float)));
  if (!in) throw Error(ErrorCode::file, fmt::format("{}: ends early", file.string()));
  return pixels;
}

/// PFS stream of luminance-hdr, whose channels X, Y, Z hold R, G, B (pfstools would take them for CIE XYZ): "PFS1", width height, number
/// of channels, number of tags (0 here), name and number of tags of each channel, "ENDH", then the channels one after the other.
std::vector<float> read_luminance_pfs(const std::filesystem::path& file, int width, int height) {
  std::ifstream in(file, std::ios::binary);
  std::string text;
  const std::string header = fmt::format("PFS1\n{} {}\n3\n0\nX\n0\nY\n0\nZ\n0\nENDH", width, height);
  text.resize(header.size());
  in.read(text.data(), static_cast<std::streamsize>(text.size()));
  if (text != header) throw Error(ErrorCode::file, fmt::format("{}: expected three channels of {} x {}", file.string(), width, height));
  const std::size_t n = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  std::vector<float> planes(3 * n), pixels(3 * n);
  in.read(reinterpret_cast<char*>(planes.data()), static_cast<std::streamsize>(planes.size() * sizeof(float)));
  if (!in) throw Error(ErrorCode::file, fmt::format("{}: ends early", file.string()));
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t c = 0; c < 3; ++c) pixels[3 * i + c] = planes[c * n + i];
  return pixels;
}

struct Program {
  std::string name, package, executable, command;  ///< command writes `output`
  std::string output;
  std::vector<float> (*read)(const std::filesystem::path&, int, int);
};

PeerResult run(const Program& program, const std::filesystem::path& folder, int width, int height) {
  PeerResult result{program.name, {}, {}, {}, {}, {}, {}};
  const auto output = folder / program.output;
  std::filesystem::remove(output);
  if (!installed(program.executable)) {
    result.unavailable = fmt::format("not installed (Debian: {})", program.package);
    return result;
  }
  bool good = false;
  result.whole = time_repeats(1, [&] { good = shell(folder, program.command, "log.txt"); });
  if (!good || !std::filesystem::exists(output)) {
    result.unavailable = fmt::format("failed: {}", brdf::read_text(folder / "log.txt").substr(0, 300));
    return result;
  }
  result.radiance = program.read(output, width, height);
  return result;
}

}  // namespace

std::vector<PeerResult> run_programs(const std::vector<acquire::RawFrame>& frames, const std::filesystem::path& folder) {
  std::string script, files, stops;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    const std::string name = fmt::format("frame{:02}.tif", i);
    acquire::write_frame(folder / name, frames[i]);
    script += fmt::format("{} {:.9g} 1 100 0\n", name, 1 / frames[i].actual.exposure_s);  // file, 1 / s, aperture, ISO
    files += " " + name;
    stops += fmt::format("{}{:.6f}", i ? "," : "", std::log2(frames[i].actual.exposure_s));
  }
  brdf::write_text_atomically(folder / "stack.hdrgen", script);
  const std::string luminance = "QT_QPA_PLATFORM=offscreen HOME=. luminance-hdr-cli -e " + stops + " -s result.pfs ";
  const std::vector<Program> programs{
      {"pfshdrcalibrate", "pfstools", "pfshdrcalibrate", "pfsinhdrgen stack.hdrgen | pfshdrcalibrate | pfsoutpfm result.pfm", "result.pfm", read_pfm},
      {"luminance-hdr Robertson", "luminance-hdr", "luminance-hdr-cli", luminance + "--hdrModel robertsonauto" + files, "result.pfs",
       read_luminance_pfs},
      // Debevec's merge there takes a fixed curve: the one that its Robertson finds.
      {"luminance-hdr Debevec", "luminance-hdr", "luminance-hdr-cli",
       luminance + "--hdrModel robertsonauto --outputCameraResponseCurve curve.csv" + files + "; " + luminance +
           "--hdrModel debevec --hdrResponseCurve from_file --inputCameraResponseCurve curve.csv" + files,
       "result.pfs", read_luminance_pfs}};
  std::vector<PeerResult> results;
  for (const Program& p : programs) results.push_back(run(p, folder, frames[0].width, frames[0].height));
  return results;
}

std::vector<std::string> peer_versions() {
  std::vector<std::string> versions{"OpenCV " CV_VERSION};
  for (const std::string package : {"pfstools", "luminance-hdr"}) {
    FILE* pipe = popen(("dpkg-query -W -f='${Version}' " + package + " 2>/dev/null").c_str(), "r");
    char text[100] = "";
    const bool found = pipe && std::fgets(text, sizeof text, pipe);
    if (pipe) pclose(pipe);
    versions.push_back(package + (found ? std::string(" ") + text : " not installed"));
  }
  return versions;
}

}  // namespace lacquer::bench
