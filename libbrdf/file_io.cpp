#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <fstream>

#include "libbrdf/file_error.h"
#include "libbrdf/files.h"

namespace lacquer::brdf {

namespace {

namespace fs = std::filesystem;

/// An open file descriptor; closed at the end of its life.
class Descriptor {
 public:
  Descriptor(const fs::path& file, int flags) : fd_(::open(file.c_str(), flags | O_CLOEXEC)) {}
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  int get() const { return fd_; }

 private:
  int fd_;
};

/// Opens a regular file for reading and returns its size. O_NONBLOCK: a FIFO must not block before it is refused.
std::uint64_t check_regular(const fs::path& file, const Descriptor& in) {
  if (in.get() < 0) fail_file(file, fmt::format("cannot be opened: {}", std::strerror(errno)));
  struct stat status {};
  if (::fstat(in.get(), &status) != 0) fail_file(file, fmt::format("cannot be read: {}", std::strerror(errno)));
  if (!S_ISREG(status.st_mode)) fail_file(file, S_ISDIR(status.st_mode) ? "is a folder, expected a file" : "is not a regular file");
  return static_cast<std::uint64_t>(status.st_size);
}

/// Up to `size` bytes into `data`; fewer only at the end of the file.
std::size_t read_some(const fs::path& file, const Descriptor& in, std::byte* data, std::size_t size) {
  std::size_t done = 0;
  while (done < size) {
    const ssize_t n = ::read(in.get(), data + done, size - done);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) fail_file(file, fmt::format("cannot be read: {}", std::strerror(errno)));
    if (n == 0) break;
    done += static_cast<std::size_t>(n);
  }
  return done;
}

std::string hex(XXH128_hash_t hash) {
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, hash);
  std::string text;
  for (const unsigned char byte : canonical.digest) text += fmt::format("{:02x}", byte);
  return text;
}

/// Same folder as `file`, so that the rename stays on one file system; the extension is kept because some writers choose by it.
fs::path temporary_name(const fs::path& file) {
  static std::atomic<unsigned> counter{0};
  fs::path name = file;
  name.replace_filename(fmt::format(".{}.{}-{}.tmp{}", file.stem().string(), ::getpid(), counter++, file.extension().string()));
  return name;
}

/// Content on disk before the name changes: after a power cut the name shows either the old file or the whole new one.
void sync_to_disk(const fs::path& file, int flags) {
  const Descriptor descriptor(file, flags);
  // EINVAL: a file system that cannot sync (some network and special ones); the rename is still atomic there.
  if (descriptor.get() < 0 || (::fsync(descriptor.get()) != 0 && errno != EINVAL))
    fail_file(file, fmt::format("cannot be written to disk: {}", std::strerror(errno)));
}

}  // namespace

void write_atomically(const fs::path& file, const std::function<void(const fs::path&)>& write) {
  if (!file.has_filename()) fail_file(file, "cannot be written: not a file name");
  const fs::path folder = file.has_parent_path() ? file.parent_path() : fs::path(".");
  std::error_code status;
  if (!fs::is_directory(folder, status)) fail_file(file, fmt::format("cannot be written: no folder {}", folder.string()));
  if (fs::is_directory(file, status)) fail_file(file, "cannot be written: is a folder");

  const fs::path temporary = temporary_name(file);
  try {
    write(temporary);
    sync_to_disk(temporary, O_RDONLY);
    fs::rename(temporary, file, status);
    if (status) fail_file(file, fmt::format("cannot be written: {}", status.message()));
    sync_to_disk(folder, O_RDONLY | O_DIRECTORY);  // the new name too
  } catch (...) {
    std::error_code ignored;
    fs::remove(temporary, ignored);
    throw;
  }
}

void write_text_atomically(const fs::path& file, const std::string& text) {
  write_atomically(file, [&](const fs::path& temporary) {
    errno = 0;
    std::ofstream out(temporary, std::ios::binary);
    out.write(text.data(), static_cast<std::streamsize>(text.size()));
    out.close();
    if (!out) fail_file(file, fmt::format("cannot be written: {}", errno ? std::strerror(errno) : "unknown reason"));
  });
}

std::vector<std::byte> read_bytes(const fs::path& file, std::uint64_t max_bytes) {
  const Descriptor in(file, O_RDONLY | O_NONBLOCK);
  const std::uint64_t size = check_regular(file, in);
  if (size > max_bytes) fail_file(file, fmt::format("has {} bytes, expected at most {}", size, max_bytes));
  std::vector<std::byte> bytes(size);
  if (read_some(file, in, bytes.data(), bytes.size()) != bytes.size()) fail_file(file, "became shorter while it was read");
  return bytes;
}

std::vector<std::byte> read_prefix(const fs::path& file, std::size_t max_bytes) {
  const Descriptor in(file, O_RDONLY | O_NONBLOCK);
  check_regular(file, in);
  std::vector<std::byte> bytes(max_bytes);
  bytes.resize(read_some(file, in, bytes.data(), bytes.size()));
  return bytes;
}

std::string read_text(const fs::path& file, std::uint64_t max_bytes) {
  const auto bytes = read_bytes(file, max_bytes);
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

std::string checksum(std::span<const std::byte> bytes) { return hex(XXH3_128bits(bytes.data(), bytes.size())); }

std::string file_checksum(const fs::path& file) {
  const Descriptor in(file, O_RDONLY | O_NONBLOCK);
  check_regular(file, in);
  const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(XXH3_createState(), XXH3_freeState);
  if (!state) throw std::bad_alloc();
  XXH3_128bits_reset(state.get());
  std::vector<std::byte> block(1u << 20);
  while (const std::size_t n = read_some(file, in, block.data(), block.size()))
    XXH3_128bits_update(state.get(), block.data(), n);
  return hex(XXH3_128bits_digest(state.get()));
}

const char* version() { return LACQUER_VERSION; }

}  // namespace lacquer::brdf
