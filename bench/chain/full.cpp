#include "bench/chain/full.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <stdexcept>

#include "libbrdf/brdf.h"
#include "libbrdf/files.h"
#include "libbrdf/metrics.h"

extern char** environ;

namespace lacquer::bench {

namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

/// Out of the system's cache, so that the next read comes from the disk.
void drop(const fs::path& file) {
  const int fd = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) return;
  ::fsync(fd);
  ::posix_fadvise(fd, 0, 0, POSIX_FADV_DONTNEED);
  ::close(fd);
}

double read_through(const fs::path& file, std::vector<char>& buffer) {
  const int fd = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) throw std::runtime_error(file.string() + ": cannot be read");
  double bytes = 0;
  for (ssize_t n = 0; (n = ::read(fd, buffer.data(), buffer.size())) > 0;) bytes += static_cast<double>(n);
  ::close(fd);
  return bytes;
}

/// Runs lacquer, quiet; wall time and peak memory.
FullRun::Stage command(const std::string& name, std::vector<std::string> arguments) {
  arguments.insert(arguments.begin(), {LACQUER_BINARY, "-q"});
  std::vector<char*> pointers;
  for (auto& a : arguments) pointers.push_back(a.data());
  pointers.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
  const auto start = Clock::now();
  pid_t child = 0;
  const int error = posix_spawn(&child, LACQUER_BINARY, &actions, nullptr, pointers.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (error != 0) throw std::runtime_error(std::string(LACQUER_BINARY) + ": cannot be started");
  int status = 0;
  rusage usage{};
  ::wait4(child, &status, 0, &usage);
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) throw std::runtime_error(name + " failed");
  return {name, seconds_since(start), static_cast<double>(usage.ru_maxrss) / 1024};
}

}  // namespace

DiskRate measure_disk(const fs::path& folder, std::size_t bytes) {
  const fs::path file = folder / "disk.tmp";
  std::vector<char> buffer(std::size_t{4} << 20);
  for (std::size_t i = 0; i < buffer.size(); ++i) buffer[i] = static_cast<char>(i * 2654435761u >> 13);  // nothing that a disk could shorten
  DiskRate rate;
  auto start = Clock::now();
  const int fd = ::open(file.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (fd < 0) throw std::runtime_error(file.string() + ": cannot be written");
  for (std::size_t done = 0; done < bytes; done += buffer.size())
    if (::write(fd, buffer.data(), buffer.size()) < 0) throw std::runtime_error(file.string() + ": cannot be written");
  ::fsync(fd);
  ::close(fd);
  rate.write = static_cast<double>(bytes) / seconds_since(start);
  drop(file);
  start = Clock::now();
  const double read = read_through(file, buffer);
  rate.read = read / seconds_since(start);
  fs::remove(file);
  return rate;
}

FullRun run_full(const fs::path& folder, const fs::path& rig, const fs::path& paint) {
  const fs::path session = folder / "full";
  FullRun full;
  if (!fs::exists(session / "session.json")) {
    std::fprintf(stderr, "simulating the frames\n");
    std::vector<std::string> capture{"capture", rig.string(), "-o", session.string(), "--no-checks"};
    if (fs::exists(session)) capture.push_back("--resume");
    command("capture", capture);
  } else if (brdf::read_text(session / "rig.toml") != brdf::read_text(rig)) {
    throw std::runtime_error(session.string() + " was captured by another rig file; remove it");
  }

  std::vector<fs::path> frames;
  for (const auto& entry : fs::directory_iterator(session / "frames")) frames.push_back(entry.path());
  for (const auto& f : frames) drop(f);
  std::vector<char> buffer(std::size_t{4} << 20);
  auto start = Clock::now();
  for (const auto& f : frames) full.raw_bytes += read_through(f, buffer);
  full.read_once_s = seconds_since(start);
  for (const auto& f : frames) drop(f);

  const std::string s = session.string();
  for (auto& [name, arguments] : std::vector<std::pair<std::string, std::vector<std::string>>>{{"merge", {"merge", s}},
                                                                                              {"tabulate", {"tabulate", s}},
                                                                                              {"fit", {"fit", (session / "table.exr").string(), "-o", (session / "fit.json").string()}}}) {
    full.stages.push_back(command(name, arguments));
    full.total_s += full.stages.back().seconds;
  }
  full.mean_abs_log = brdf::compare(*brdf::load_brdf(paint), *brdf::load_brdf(session / "fit.json")).mean_abs_log;
  for (const char* made : {"radiance", "calibration.json", "table.exr", "fit.json"}) fs::remove_all(session / made);
  return full;
}

}  // namespace lacquer::bench
