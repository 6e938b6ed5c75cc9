#include "tools/html.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cctype>
#include <filesystem>

#include "libbrdf/files.h"

namespace lacquer::tools {

namespace {

/// Contrast of text and lines on their ground is at least 4.5 : 1 in both schemes.
constexpr const char* style = R"(<style>
:root { color-scheme: light dark; --ground: #fff; --ink: #222; --soft: #595959; --line: #ddd; --warn: #a33f00; --link: #00558f; }
@media (prefers-color-scheme: dark) {
  @media screen { :root { --ground: #16181b; --ink: #e4e4e4; --soft: #a8a8a8; --line: #3a3d42; --warn: #ff9d57; --link: #7cc4ff; } }
}
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 76rem; margin: 0 auto; padding: 1rem; background: var(--ground); color: var(--ink); }
a { color: var(--link); } a:focus-visible, summary:focus-visible, [tabindex]:focus-visible { outline: 3px solid var(--link); outline-offset: 2px; }
.skip { position: absolute; left: -99rem; } .skip:focus { left: 1rem; background: var(--ground); padding: .5rem; z-index: 1; }
h1 { font-size: 1.6rem; margin: .5rem 0; } h2 { font-size: 1.25rem; margin-top: 2.5rem; border-bottom: 1px solid var(--line); }
h3 { font-size: 1.05rem; margin-top: 1.5rem; }
nav ul { display: flex; flex-wrap: wrap; gap: .2rem 1.2rem; list-style: none; padding: 0; }
pre { overflow-x: auto; padding: .6rem; border: 1px solid var(--line); font-size: .82rem; }
.warning { border-left: 4px solid var(--warn); padding: .3rem .8rem; margin: .5rem 0; }
.row { display: flex; flex-wrap: wrap; gap: 1.2rem; align-items: flex-start; } .row > * { min-width: 0; max-width: 100%; }
figure { margin: 0; flex: 1 1 24rem; max-width: 36rem; min-width: 0; } figure.wide { flex-basis: 100%; max-width: 100%; }
figure.small { flex: 0 1 11rem; max-width: 14rem; } figure.medium { flex: 0 1 17rem; max-width: 22rem; }
figcaption { font-size: .88rem; color: var(--soft); } img, svg { max-width: 100%; height: auto; display: block; }
svg { color: var(--ink); } svg image, img.pixels { image-rendering: pixelated; }
.scroll { overflow-x: auto; max-width: 100%; } table { border-collapse: collapse; font-size: .9rem; margin: .8rem 0; font-variant-numeric: tabular-nums; }
caption { text-align: left; color: var(--soft); padding-bottom: .3rem; } th, td { padding: .15rem .7rem; border-bottom: 1px solid var(--line); text-align: left; white-space: nowrap; } caption { white-space: normal; }
.number { text-align: right; } th { font-weight: 600; } td { min-width: 4rem; } output { display: block; min-height: 1.4em; font-size: .88rem; }
@media print { body { max-width: none; font-size: 10pt; } .scroll { overflow: visible; } th, td { white-space: normal; padding: .1rem .35rem; } pre { white-space: pre-wrap; } nav, .skip, output { display: none; } figure, table { break-inside: avoid; } details > * { display: block; } }
</style>)";

/// Shows angles and value under the pointer, or at the place that the arrow keys lead to.
constexpr const char* script = R"(<script>
document.querySelectorAll('figure[data-values]').forEach(figure => {
  const d = figure.dataset, image = figure.querySelector('svg image'), out = figure.querySelector('output');
  const codes = atob(d.values), n = 90, low = +d.low, high = +d.high;
  let column = 45, row = 45;
  const show = () => {
    const code = codes.charCodeAt(row * n + column), edge = i => (i / n) ** 2 * 90;
    const value = low + (high - low) * (code - 1) / 254;
    out.textContent = `θh ${edge(row).toFixed(2)}–${edge(row + 1).toFixed(2)}°, θd ${column}–${column + 1}°: ` +
      (code === 0 ? 'nothing' : (d.log ? (10 ** value).toPrecision(3) : value.toPrecision(3)) + ' ' + d.unit);
  };
  figure.tabIndex = 0;
  figure.addEventListener('pointermove', event => {
    const box = image.getBoundingClientRect();
    column = Math.floor((event.clientX - box.left) / box.width * n); row = Math.floor((event.clientY - box.top) / box.height * n);
    if (column >= 0 && row >= 0 && column < n && row < n) show(); else { column = row = 45; out.textContent = ''; }
  });
  figure.addEventListener('keydown', event => {
    const step = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]}[event.key];
    if (!step) return;
    event.preventDefault();
    column = Math.min(n - 1, Math.max(0, column + step[0])); row = Math.min(n - 1, Math.max(0, row + step[1]));
    show();
  });
});
</script>)";

void replace_all(std::string& text, const std::string& what, const std::string& by) {
  for (std::size_t at = text.find(what); at != std::string::npos; at = text.find(what, at + by.size())) text.replace(at, what.size(), by);
}

bool is_number(const std::string& text) { return !text.empty() && (std::isdigit(static_cast<unsigned char>(text[0])) || ((text[0] == '-' || text[0] == '+') && text.size() > 1)); }

}  // namespace

std::string html_escaped(const std::string& s) {
  std::string out;
  for (const char c : s) {
    switch (c) {
      case '<': out += "&lt;"; break;
      case '>': out += "&gt;"; break;
      case '&': out += "&amp;"; break;
      case '"': out += "&quot;"; break;
      default: out += c;
    }
  }
  return out;
}

std::string html_table(const std::string& caption, const std::vector<std::string>& columns, const std::vector<std::vector<std::string>>& rows) {
  std::string html = "<div class=scroll><table><caption>" + html_escaped(caption) + "</caption><thead><tr>";
  for (std::size_t i = 0; i < columns.size(); ++i) {
    const bool numbers = i > 0 && !rows.empty() && i < rows.front().size() && is_number(rows.front()[i]);
    html += fmt::format("<th scope=col{}>{}</th>", numbers ? " class=number" : "", html_escaped(columns[i]));
  }
  html += "</tr></thead><tbody>\n";
  for (const auto& row : rows) {
    html += "<tr>";
    for (std::size_t i = 0; i < row.size(); ++i)
      html += i == 0 ? "<th scope=row>" + html_escaped(row[i]) + "</th>"
                     : fmt::format("<td{}>{}</td>", is_number(row[i]) ? " class=number" : "", html_escaped(row[i]));
    html += "</tr>\n";
  }
  return html + "</tbody></table></div>\n";
}

std::string html_section(const std::string& id, const std::string& title, const std::string& body) {
  return fmt::format("<section id=\"{0}\" aria-labelledby=\"{0}-title\"><h2 id=\"{0}-title\">{1}</h2>\n{2}</section>\n", id, html_escaped(title), body);
}

std::string html_figure(const std::string& content, const std::string& caption, const std::string& size) {
  return fmt::format("<figure{}>{}<figcaption>{}</figcaption></figure>\n", size.empty() ? "" : " class=" + size, content, html_escaped(caption));
}

std::string html_image(const std::string& png, const std::string& alt) {
  return fmt::format("<img alt=\"{}\" src=\"data:image/png;base64,{}\">", html_escaped(alt), base64(png));
}

TemporarySvg::TemporarySvg() {
  static std::atomic<int> n = 0;
  path_ = std::filesystem::temp_directory_path() / fmt::format("lacquer-{}-{}.svg", ::getpid(), n++);
}

TemporarySvg::~TemporarySvg() {
  std::error_code ignored;
  std::filesystem::remove(path_, ignored);
}

std::string html_plot(const std::string& plot, PlotSize size, const std::string& id, const std::string& alt) {
  const TemporarySvg file;
  gnuplot(plot, file.path(), size);
  return html_svg(brdf::read_text(file.path()), size, id, alt);
}

std::string html_svg(std::string svg, PlotSize size, const std::string& id, const std::string& alt) {
  svg.erase(0, svg.find("<svg"));
  svg.replace(0, 4, fmt::format("<svg role=img aria-label=\"{}\" width={} height={}", html_escaped(alt), size.width_px, size.height_px));
  // The first two say "Gnuplot", and would be shown under the pointer.
  for (const char* const tag : {"title", "desc"}) {
    const std::size_t begin = svg.find(fmt::format("<{}>", tag)), end = svg.find(fmt::format("</{}>", tag));
    if (begin != std::string::npos && end != std::string::npos) svg.erase(begin, end + std::string(tag).size() + 3 - begin);
  }
  for (int i = 1; i < 64; ++i) replace_all(svg, fmt::format("<title>gnuplot_plot_{}</title>", i), "");  // curves without a title of their own
  if (const std::size_t ground = svg.find("<rect x=\"0\" y=\"0\""); ground != std::string::npos) svg.erase(ground, svg.find("/>", ground) + 2 - ground);
  for (const char* const part : {"gnuplot_", "gpDot", "gpPt", "textbox", "greybox"})
    for (const char* const before : {"id=\"", "id='", "href='#", "url(#"}) replace_all(svg, std::string(before) + part, std::string(before) + id + part);
  // Strokes and texts write the same colours in two ways.
  for (const char* const ink : {"rgb( 34,  34,  34)", "rgb(34,34,34)"}) replace_all(svg, ink, "var(--ink)");
  for (const char* const soft : {"rgb(102, 102, 102)", "rgb(102,102,102)"}) replace_all(svg, soft, "var(--soft)");
  for (const char* const line : {"rgb(226, 226, 226)", "rgb(226,226,226)"}) replace_all(svg, line, "var(--line)");
  replace_all(svg, "'black'", "'var(--ink)'");
  replace_all(svg, "\"black\"", "\"var(--ink)\"");
  return svg;
}

std::string html_page(const std::string& title, const std::string& introduction, const std::vector<HtmlSection>& sections) {
  std::string html = "<!doctype html>\n<html lang=en><head><meta charset=utf-8><meta name=viewport content=\"width=device-width, initial-scale=1\">"
                     "<link rel=icon href=\"data:,\">";
  html += fmt::format("<title>{0}</title>{1}</head><body>\n<a class=skip href=\"#main\">Skip to the content</a>\n<h1>{0}</h1>\n{2}", html_escaped(title), style,
                      introduction);
  html += "<nav aria-label=Contents><ul>";
  for (const auto& section : sections) html += fmt::format("<li><a href=\"#{}\">{}</a></li>", section.id, html_escaped(section.title));
  html += "</ul></nav>\n<main id=\"main\">\n";
  for (const auto& section : sections) html += html_section(section.id, section.title, section.body);
  return html + "</main>\n" + script + "</body></html>\n";
}

std::string base64(const std::string& bytes) {
  static constexpr char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t n = std::min<std::size_t>(3, bytes.size() - i);
    unsigned v = 0;
    for (std::size_t k = 0; k < 3; ++k) v = v << 8 | (k < n ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    for (std::size_t k = 0; k < 4; ++k) out += k <= n ? digits[v >> (18 - 6 * k) & 63] : '=';
  }
  return out;
}

}  // namespace lacquer::tools
