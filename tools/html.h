#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "tools/plot.h"

/// Parts of a self-contained HTML page: no network, scripts only for comfort, readable by screen readers and on paper.
namespace lacquer::tools {

/// Text as HTML shows it.
std::string html_escaped(const std::string& text);

/// Table with a caption and a header row; the first cell of a row is its header. Cells are text, numbers are aligned right.
std::string html_table(const std::string& caption, const std::vector<std::string>& columns, const std::vector<std::vector<std::string>>& rows);

std::string html_section(const std::string& id, const std::string& title, const std::string& body);

/// A figure with its caption (text); `content`: <img> or <svg>. `size`: "small", "medium", "" or "wide" (the whole line).
std::string html_figure(const std::string& content, const std::string& caption, const std::string& size = "");

/// <img> of a PNG; `alt` says what is to be seen.
std::string html_image(const std::string& png, const std::string& alt);

/// gnuplot's picture of `script` as <svg> for use inside a page: names of its parts are unique (`id` before each), its black and
/// greys are those of the page, so that it can be dark. `alt` says what is to be seen.
std::string html_plot(const std::string& script, PlotSize size, const std::string& id, const std::string& alt);

/// The same of an SVG that gnuplot() wrote already.
std::string html_svg(std::string svg, PlotSize size, const std::string& id, const std::string& alt);

/// A name for an SVG on its way into a page; the file is removed with the object.
class TemporarySvg {
 public:
  TemporarySvg();
  TemporarySvg(const TemporarySvg&) = delete;
  TemporarySvg& operator=(const TemporarySvg&) = delete;
  ~TemporarySvg();
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// The whole page. `sections`: html_section, with ids and titles for the table of contents.
struct HtmlSection {
  std::string id, title, body;
};
std::string html_page(const std::string& title, const std::string& introduction, const std::vector<HtmlSection>& sections);

std::string base64(const std::string& bytes);

}  // namespace lacquer::tools
