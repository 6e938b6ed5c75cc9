#include "tools/plot.h"

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iterator>

#include "libbrdf/error.h"
#include "test_support.h"

namespace lacquer::tools {
namespace {

std::string content(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

std::string error_of(const std::string& script, const std::filesystem::path& output, ErrorCode code = ErrorCode::file) {
  try {
    gnuplot(script, output);
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), code);
    EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos);
    return e.what();
  }
  return "no error";
}

TEST(Plot, SuffixChoosesSvgOrPng) {
  const test::TemporaryFolder folder;
  gnuplot("plot x", folder / "a.svg");
  gnuplot("plot x", folder / "a.png");
  EXPECT_NE(content(folder / "a.svg").find("<svg"), std::string::npos);
  EXPECT_EQ(content(folder / "a.png").substr(1, 3), "PNG");
  EXPECT_NE(error_of("plot x", folder / "a.pdf", ErrorCode::usage).find("expected a plot file that ends in .svg or .png"), std::string::npos);
}

TEST(Plot, ForeignTextIsShownAsItIs) {
  const test::TemporaryFolder folder;
  gnuplot("set title " + plot_text("a_b^c {x} 'q' `touch bad` \\n $HOME") + "\nplot x", folder / "a.svg");
  EXPECT_NE(content(folder / "a.svg").find("a_b^c {x} 'q' `touch bad` \\n $HOME"), std::string::npos);
}

TEST(Plot, ValuesThatAreNotFiniteAreMissing) {
  const std::string text = plot_data("d", {{1, NAN}, {INFINITY, 0.5}});
  EXPECT_EQ(text, "$d << EOD\n1 ?\n? 0.5\nEOD\n");
  const test::TemporaryFolder folder;
  gnuplot(text + plot_data("e", {{0, 1, 2}, {0, NAN, 3}}) + "plot $e using 1:2 with lines", folder / "a.svg");
  EXPECT_TRUE(std::filesystem::exists(folder / "a.svg"));
}

TEST(Plot, ScriptThatFailsLeavesTheOldPictureAndSaysWhy) {
  const test::TemporaryFolder folder;
  test::write_file(folder / "a.svg", "old");
  EXPECT_NE(error_of("plot nothing_of_this_name", folder / "a.svg").find("undefined variable: nothing_of_this_name"), std::string::npos);
  EXPECT_EQ(content(folder / "a.svg"), "old");
  EXPECT_NE(error_of("", folder / "a.svg").find("drew nothing"), std::string::npos);
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder.path()), {}), 1) << "temporary files are gone";
}

TEST(Plot, MissingGnuplotIsOneClearLine) {
  const test::TemporaryFolder folder;
  const std::string path = std::getenv("PATH");
  setenv("PATH", folder.path().c_str(), 1);
  const std::string error = error_of("plot x", folder / "a.svg");
  setenv("PATH", path.c_str(), 1);
  EXPECT_NE(error.find("gnuplot is not installed"), std::string::npos) << error;
}

}  // namespace
}  // namespace lacquer::tools
