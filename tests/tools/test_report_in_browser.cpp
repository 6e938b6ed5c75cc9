#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>

#include "libbrdf/files.h"
#include "test_support.h"

/// The page in a real browser.
namespace lacquer {
namespace {

/// Text between <title> and </title> of the page after its scripts ran, in a window `width` wide.
std::string title_in_browser(const std::filesystem::path& page, int width, const test::TemporaryFolder& folder) {
  const std::string out = (folder / "dom.html").string();
  const std::string command = "timeout 60 chromium --headless=new --no-sandbox --disable-gpu --user-data-dir=" + (folder / "profile").string() + " --window-size=" + std::to_string(width) +
                              ",900 --dump-dom file://" + page.string() + " > " + out + " 2> /dev/null";
  if (std::system(command.c_str()) != 0) return "the browser failed";
  const std::string dom = brdf::read_text(out);
  const std::size_t from = dom.find("<title>"), to = dom.find("</title>");
  return from == std::string::npos || to == std::string::npos ? "no title" : dom.substr(from + 7, to - from - 7);
}

TEST(ReportInBrowser, HasNoErrorsAndFitsDesktopAndPhone) {
  if (std::system("command -v chromium > /dev/null") != 0) GTEST_SKIP() << "SKIPPED LOUDLY: no chromium here; apt-get install chromium";
  const test::TemporaryFolder folder;
  const auto session = folder / "s";
  const auto measured = test::run_lacquer("-q measure " + (test::source_dir() / "data-samples/tiny-rig.toml").string() + " -o " + session.string());
  ASSERT_EQ(measured.exit_code, 0) << measured.err;
  std::string page = brdf::read_text(session / "report.html");
  EXPECT_LT(page.size(), 8u << 20);
  // Beside the page's own script: counts errors from the first moment, and says at the end what it saw in place of the title.
  const std::string first = "<script>let errors = []; addEventListener('error', e => errors.push(e.message)); "
                            "for (const kind of ['error', 'warn']) console[kind] = text => errors.push(text);</script>",
                    last = "<script>addEventListener('load', () => { const e = document.documentElement; document.querySelectorAll('figure[data-values]')[0].dispatchEvent("
                           "new KeyboardEvent('keydown', {key: 'ArrowDown'})); document.title = errors.length + ' errors; ' + (e.scrollWidth <= e.clientWidth ? 'fits' : 'wider by ' + "
                           "(e.scrollWidth - e.clientWidth)) + '; ' + (document.querySelector('output').textContent ? 'read out' : 'silent') + '; ' + errors.join(' | '); });</script>";
  page.replace(page.find("<head>"), 6, "<head>" + first);
  page.replace(page.rfind("</body>"), 7, last + "</body>");
  test::write_file(folder / "page.html", page);
  for (const int width : {1280, 500})  // 500: the narrowest window that headless Chromium makes
    EXPECT_EQ(title_in_browser(folder / "page.html", width, folder), "0 errors; fits; read out; ") << width;
}

}  // namespace
}  // namespace lacquer
