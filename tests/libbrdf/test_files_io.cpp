#include <sys/stat.h>

#include <thread>

#include "libbrdf/files.h"
#include "tests/libbrdf/file_test_support.h"

namespace lacquer::brdf {
namespace {

using test::expect_file_error;
using test::slurp;
using test::TemporaryFolder;

std::size_t n_files(const TemporaryFolder& folder) {
  return static_cast<std::size_t>(std::distance(std::filesystem::directory_iterator(folder.path()), {}));
}

TEST(WriteAtomically, ReplacesTheOldContentAndLeavesNoTemporary) {
  TemporaryFolder folder;
  write_text_atomically(folder / "a.txt", "old");
  write_text_atomically(folder / "a.txt", "new");
  EXPECT_EQ(slurp(folder / "a.txt"), "new");
  EXPECT_EQ(n_files(folder), 1u);
}

TEST(WriteAtomically, KeepsTheOldContentWhenTheWriterFailsHalfWay) {
  TemporaryFolder folder;
  write_text_atomically(folder / "a.txt", "old");
  EXPECT_THROW(write_atomically(folder / "a.txt",
                                [](const std::filesystem::path& temporary) {
                                  test::write_file(temporary, "hal");
                                  throw std::runtime_error("power cut");
                                }),
               std::runtime_error);
  EXPECT_EQ(slurp(folder / "a.txt"), "old");
  EXPECT_EQ(n_files(folder), 1u);
}

TEST(WriteAtomically, TemporaryIsInTheSameFolderWithTheSameExtension) {
  TemporaryFolder folder;
  write_atomically(folder / "a.exr", [&](const std::filesystem::path& temporary) {
    EXPECT_EQ(temporary.parent_path(), folder.path());
    EXPECT_EQ(temporary.extension(), ".exr");
    EXPECT_NE(temporary, folder / "a.exr");
    test::write_file(temporary, "x");
  });
}

TEST(WriteAtomically, TwoWritersOfOneFileLeaveOneWholeContent) {
  TemporaryFolder folder;
  const std::string a(100000, 'a'), b(100000, 'b');
  const auto write = [&](const std::string& text) {
    for (int i = 0; i < 10; ++i) write_text_atomically(folder / "f", text);
  };
  std::thread first(write, a), second(write, b);
  first.join();
  second.join();
  const std::string content = slurp(folder / "f");
  EXPECT_TRUE(content == a || content == b);
}

TEST(WriteAtomically, NamesTheFolderThatIsMissing) {
  TemporaryFolder folder;
  expect_file_error([&] { write_text_atomically(folder / "none" / "a.txt", "x"); }, {"none/a.txt", "no folder"});
  expect_file_error([&] { write_text_atomically(folder.path(), "x"); }, {folder.path().string(), "folder"});
}

TEST(WriteAtomically, WritesRelativeToTheWorkingFolder) {
  TemporaryFolder folder;
  const auto before = std::filesystem::current_path();
  std::filesystem::current_path(folder.path());
  write_text_atomically("plain.txt", "x");
  std::filesystem::current_path(before);
  EXPECT_EQ(slurp(folder / "plain.txt"), "x");
}

TEST(ReadBytes, RefusesWhatIsNotARegularFileOrTooLarge) {
  TemporaryFolder folder;
  test::write_file(folder / "five", "12345");
  EXPECT_EQ(read_text(folder / "five", 5), "12345");
  expect_file_error([&] { read_text(folder / "five", 4); }, {"five", "5 bytes", "at most 4"});
  expect_file_error([&] { read_text(folder / "none"); }, {"none", "No such file"});
  expect_file_error([&] { read_text(folder.path()); }, {"folder"});
  ASSERT_EQ(mkfifo((folder / "pipe").c_str(), 0600), 0);
  expect_file_error([&] { read_text(folder / "pipe"); }, {"pipe", "not a regular file"});
}

TEST(ReadPrefix, StopsAtTheEndOfTheFile) {
  TemporaryFolder folder;
  test::write_file(folder / "five", "12345");
  EXPECT_EQ(read_prefix(folder / "five", 3).size(), 3u);
  EXPECT_EQ(read_prefix(folder / "five", 100).size(), 5u);
}

TEST(Checksum, IsXxh3With128BitsInCanonicalOrder) {
  // Published test value of XXH3_128bits for empty input, seed 0 (xxHash's own sanity checks): low64 0x6001C324468D497F,
  // high64 0x99AA06D3014798D8, printed high first.
  EXPECT_EQ(checksum({}), "99aa06d3014798d86001c324468d497f");
}

TEST(Checksum, OfAFileIsThatOfItsBytesWhateverItsLength) {
  TemporaryFolder folder;
  for (const std::size_t size : {0u, 1u, 241u, 1u << 20, (1u << 20) + 1u, 3000000u}) {
    std::string text(size, '\0');
    for (std::size_t i = 0; i < size; ++i) text[i] = static_cast<char>(i * 7919 >> 3);
    test::write_file(folder / "f", text);
    EXPECT_EQ(file_checksum(folder / "f"), checksum(std::as_bytes(std::span(text)))) << size;
  }
}

TEST(Checksum, ReadmeOfTheSamplesStatesTheChecksumOfEverySample) {
  const auto samples = test::source_dir() / "data-samples";
  const std::string readme = slurp(samples / "README.md");
  int n = 0;
  for (const char* folder : {"paints", "measured"})
    for (const auto& entry : std::filesystem::directory_iterator(samples / folder)) {
      const std::string name = std::string(folder) + "/" + entry.path().filename().string();
      const auto row = readme.find("| `" + name + "` |");
      ASSERT_NE(row, std::string::npos) << name << " is not in data-samples/README.md";
      const std::string line = readme.substr(row, readme.find('\n', row) - row);
      EXPECT_NE(line.find("`" + file_checksum(entry.path()) + "`"), std::string::npos) << line;
      ++n;
    }
  EXPECT_EQ(n, 9);
}

}  // namespace
}  // namespace lacquer::brdf
