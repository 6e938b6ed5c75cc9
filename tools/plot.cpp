#include "tools/plot.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <string_view>

#include "libbrdf/error.h"
#include "libbrdf/files.h"

extern char** environ;

namespace lacquer::tools {

namespace {

[[noreturn]] void fail(const std::filesystem::path& output, const std::string& what) {
  throw Error(ErrorCode::file, fmt::format("{}: {}", output.string(), what));
}

/// A file without a name, in memory: takes any amount of text without a second process having to read at the same time.
class MemoryFile {
 public:
  explicit MemoryFile(const std::filesystem::path& for_output) : fd_(memfd_create("lacquer-plot", MFD_CLOEXEC)) {
    if (fd_ < 0) fail(for_output, fmt::format("cannot be plotted: {}", std::strerror(errno)));
  }
  MemoryFile(const MemoryFile&) = delete;
  MemoryFile& operator=(const MemoryFile&) = delete;
  ~MemoryFile() { ::close(fd_); }
  int get() const { return fd_; }

  bool write(std::string_view text) const {
    while (!text.empty()) {
      const ssize_t n = ::write(fd_, text.data(), text.size());
      if (n < 0 && errno == EINTR) continue;
      if (n <= 0) return false;
      text.remove_prefix(static_cast<std::size_t>(n));
    }
    return ::lseek(fd_, 0, SEEK_SET) == 0;
  }

  std::string head() const {
    char text[2000];
    const ssize_t n = ::pread(fd_, text, sizeof text, 0);
    return {text, n > 0 ? static_cast<std::size_t>(n) : 0};
  }

 private:
  int fd_;
};

/// Okabe and Ito's palette (jfly.uni-koeln.de/color, 2008).
constexpr std::string_view look = R"(set encoding utf8
blue = "#0072B2"; vermilion = "#D55E00"; green = "#009E73"; purple = "#CC79A7"
orange = "#E69F00"; sky = "#56B4E9"; black = "#222222"; grey = "#888888"
array colours[8] = [blue, vermilion, green, purple, orange, sky, black, grey]
do for [i = 1:8] { set linetype i lc rgb colours[i] lw 1.6 pt 7 ps 0.5 }
set linetype cycle 8
set style fill transparent solid 0.2 noborder
set border 3 lc rgb "#666666" lw 0.8
set tics nomirror out textcolor rgb black
set grid back lt 1 lc rgb "#E2E2E2" lw 0.8
set key noautotitle top left reverse Left samplen 2 spacing 1.15 textcolor rgb black
set title font ",15" textcolor rgb black
set xlabel textcolor rgb black
set ylabel textcolor rgb black
set datafile missing "?"
set samples 500
)";

std::string terminal(const std::filesystem::path& output, PlotSize size) {
  return fmt::format("set terminal {} size {},{} enhanced background rgb \"#FFFFFF\" font \"sans-serif,12\"\n",
                     output.extension() == ".svg" ? "svg dynamic" : "pngcairo", size.width_px, size.height_px);
}

/// Exit status of gnuplot with its stdin, stdout and stderr on the given descriptors; -1: killed by a signal.
int run(const std::filesystem::path& output, int in, int out, int err) {
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, in, STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, out, STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, err, STDERR_FILENO);
  std::string name = "gnuplot", defaults = "-d", from_stdin = "-";  // -d: no start-up file of the user's
  char* const arguments[] = {name.data(), defaults.data(), from_stdin.data(), nullptr};
  pid_t child = 0;
  const int error = posix_spawnp(&child, "gnuplot", &actions, nullptr, arguments, environ);
  posix_spawn_file_actions_destroy(&actions);
  if (error == ENOENT) fail(output, "cannot be plotted: gnuplot is not installed (Debian: apt-get install gnuplot-nox)");
  if (error != 0) fail(output, fmt::format("cannot be plotted: gnuplot does not start: {}", std::strerror(error)));
  int status = 0;
  while (::waitpid(child, &status, 0) < 0)
    if (errno != EINTR) fail(output, fmt::format("cannot be plotted: gnuplot: {}", std::strerror(errno)));
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

/// What is wrong, out of gnuplot's echo of the line, a caret and "line 0: undefined variable: x" (0 for whatever came through stdin).
std::string complaint(const std::string& text) {
  constexpr std::string_view marker = "line 0: ";
  std::size_t start = text.find(marker);
  start = start == std::string::npos ? text.find_first_not_of('\n') : start + marker.size();
  return start == std::string::npos ? "no reason given" : text.substr(start, text.find('\n', start) - start);
}

}  // namespace

void check_plot_name(const std::filesystem::path& output) {
  if (output.extension() != ".svg" && output.extension() != ".png")
    throw Error(ErrorCode::usage, fmt::format("{}: expected a plot file that ends in .svg or .png", output.string()));
}

void gnuplot(const std::string& script, const std::filesystem::path& output, PlotSize size) {
  check_plot_name(output);
  const MemoryFile in(output), err(output);
  if (!in.write(fmt::format("{}{}{}\n", terminal(output, size), look, script)))
    fail(output, fmt::format("cannot be plotted: {}", std::strerror(errno)));
  brdf::write_atomically(output, [&](const std::filesystem::path& temporary) {
    const int out = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (out < 0) fail(output, fmt::format("cannot be written: {}", std::strerror(errno)));
    int status = 0;
    try {
      status = run(output, in.get(), out, err.get());
    } catch (...) {
      ::close(out);
      throw;
    }
    ::close(out);
    if (status != 0) fail(output, fmt::format("cannot be plotted: gnuplot: {}", complaint(err.head())));
    if (std::filesystem::file_size(temporary) == 0) fail(output, "cannot be plotted: gnuplot drew nothing");
  });
}

std::string plot_data(const std::string& name, const std::vector<std::vector<double>>& columns) {
  std::string text = fmt::format("${} << EOD\n", name);
  for (std::size_t row = 0; row < (columns.empty() ? 0 : columns.front().size()); ++row) {
    for (const auto& column : columns) text += std::isfinite(column.at(row)) ? fmt::format("{:.9g} ", column[row]) : "? ";
    text.back() = '\n';
  }
  return text + "EOD\n";
}

std::string plot_text(const std::string& text) {
  std::string quoted = "'";
  for (const char c : text) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f)
      quoted += '?';
    else if (c == '\'')
      quoted += "''";
    else if (std::strchr("\\{}^_@&~", c))
      quoted += {'\\', c};
    else
      quoted += c;
  }
  return quoted + "'";
}

}  // namespace lacquer::tools
