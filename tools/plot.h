#pragma once

#include <filesystem>
#include <string>
#include <vector>

/// Plots of all subcommands, drawn by gnuplot (Debian: gnuplot-nox) in one common look.
namespace lacquer::tools {

struct PlotSize {
  int width_px = 900;
  int height_px = 600;
};

/// Runs gnuplot on `script` and writes the picture to `output`, SVG or PNG by its suffix (temporary name, then rename). Before the script
/// come the terminal and the look: font, light grid, tics outside, line types 1 to 8 in colours that colour-blind people can tell
/// apart, the same as string variables blue, vermilion, green, purple, orange, sky, black, grey for `lc rgb`; channels R G B are meant
/// to be vermilion, green, blue. The script may neither set terminal nor output; numbers come from plot_data, foreign text from plot_text.
/// Throws Error{file} when gnuplot is not installed or rejects the script, Error{usage} for another suffix.
void gnuplot(const std::string& script, const std::filesystem::path& output, PlotSize size = {});

/// Throws Error{usage} unless `output` ends in .svg or .png: to be called before the long work whose plot it is.
void check_plot_name(const std::filesystem::path& output);

/// Data block `$name` of gnuplot: one row per index, one column per vector (all of one length). Not finite: gnuplot's missing value "?".
std::string plot_data(const std::string& name, const std::vector<std::vector<double>>& columns);

/// Text as a quoted gnuplot string that shows exactly these characters (no markup, no escapes; control characters as '?').
std::string plot_text(const std::string& text);

}  // namespace lacquer::tools
