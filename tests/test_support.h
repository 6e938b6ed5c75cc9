#pragma once

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <string>

#include <gtest/gtest.h>
#include <unistd.h>

namespace lacquer::test {

/// The repository.
inline std::filesystem::path source_dir() { return LACQUER_SOURCE_DIR; }

/// Real measurements beside the checkout (never committed). Tests that need them start with LACQUER_NEEDS_SHARED_DATA.
inline std::filesystem::path shared_data() {
  const char* override_dir = std::getenv("LACQUER_SHARED_DATA");
  return override_dir ? std::filesystem::path(override_dir) : std::filesystem::path(LACQUER_SHARED_DATA);
}

#define LACQUER_NEEDS_SHARED_DATA(relative)                                                                       \
  if (!std::filesystem::exists(::lacquer::test::shared_data() / (relative)))                                      \
  GTEST_SKIP() << "SKIPPED LOUDLY: real measurement " << (::lacquer::test::shared_data() / (relative)).string()   \
               << " is not here; set LACQUER_SHARED_DATA to the folder that has it"

/// A folder of one test, removed afterwards.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "lacquer-test-XXXXXX").string();
    if (!mkdtemp(name.data())) throw std::runtime_error("cannot create " + name);
    path_ = name;
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  ~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

inline void write_file(const std::filesystem::path& file, const std::string& content) {
  std::ofstream(file, std::ios::binary) << content;
}

/// Result of running the lacquer executable through the shell.
struct CommandResult {
  int exit_code;
  std::string out;
  std::string err;
};

inline CommandResult run_lacquer(const std::string& arguments) {
  TemporaryFolder folder;
  const std::string out = (folder / "out").string(), err = (folder / "err").string();
  const int status = std::system((std::string(LACQUER_BINARY) + " " + arguments + " >" + out + " 2>" + err).c_str());
  const auto slurp = [](const std::string& name) {
    std::ifstream in(name, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(in), {});
  };
  return {WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status), slurp(out), slurp(err)};
}

}  // namespace lacquer::test
