#include <fmt/format.h>

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libcalib/frame_list.h"
#include "libcalib/noise_json.h"
#include "libcalib/photon_transfer.h"
#include "tools/calibrate_parts.h"
#include "tools/fit_table.h"
#include "tools/json_output.h"
#include "tools/plot.h"

namespace lacquer::tools {

namespace {

using calib::Measured;
using calib::NoiseFigures;
using calib::PhotonTransfer;
using calib::TransferPoint;

struct Options {
  std::string darks, flats, layout = "mono", response = "linear", output, maps, plot;
  int bits = 8;
  bool keep_shading = false;
  calib::PhotonTransferOptions measurement;
};

std::string text_of(const std::optional<Measured>& m, double factor = 1) {
  if (!m) return "-";
  return m->sigma > 0 ? with_error(m->value * factor, m->sigma * factor) : fmt::format("{:.4g}", m->value * factor);
}

void print_row(const char* name, const char* unit, const std::vector<std::string>& cells) {
  fmt::print("{:<16} {:<7}", name, unit);
  for (const std::string& cell : cells) fmt::print(" {:>20}", cell);
  fmt::print("\n");
}

std::vector<std::string> channel_names(const PhotonTransfer& t) {
  if (t.channels.size() == 1) return {"Y"};
  return {"R", "G", "B"};
}

/// One column for all channels together and, where there are several, one for each.
void print_table(const PhotonTransfer& t) {
  std::vector<const NoiseFigures*> columns{&t.all};
  std::vector<std::string> head{"all"};
  if (t.channels.size() > 1)
    for (std::size_t c = 0; c < t.channels.size(); ++c) {
      columns.push_back(&t.channels[c]);
      head.push_back(channel_names(t)[c]);
    }
  const auto row = [&](const char* name, const char* unit, std::optional<Measured> NoiseFigures::*figure, double factor = 1) {
    std::vector<std::string> cells;
    for (const NoiseFigures* f : columns) cells.push_back(text_of(f->*figure, factor));
    print_row(name, unit, cells);
  };
  print_row("", "", head);
  row("black level", "DN", &NoiseFigures::black_level_dn);
  row("gain", "e-/DN", &NoiseFigures::gain_e_per_dn);
  row("read noise", "e-", &NoiseFigures::read_noise_e);
  row("", "DN", &NoiseFigures::read_noise_dn);
  row("dark current", "e-/s", &NoiseFigures::dark_current_e_per_s);
  row("", "DN/s", &NoiseFigures::dark_current_dn_per_s);
  row("  its spread", "DN/s", &NoiseFigures::dark_spread_dn_per_s);
  row("DSNU", "DN", &NoiseFigures::dsnu_dn);
  row("PRNU", "%", &NoiseFigures::prnu, 100);
  row("relative noise", "%", &NoiseFigures::relative_noise, 100);
  std::vector<std::string> chi;
  for (const NoiseFigures* f : columns) chi.push_back(fmt::format("{:.1f} / {}", f->chi_square, f->degrees_of_freedom));
  print_row("chi^2 / dof", "", chi);
}

void print_result(const PhotonTransfer& t, const Options& o) {
  fmt::print("{} x {} {}, {} bits{}\n", t.width, t.height, acquire::name_of(t.layout), t.bits,
             o.measurement.response && !o.measurement.response->linear ? ", linearised" : "");
  print_table(t);
  if (t.channels.size() > 1 && t.gain_measured)
    fmt::print("one gain for all: chi^2 {:.1f} for {} degrees of freedom\n", t.one_gain_chi_square, t.channels.size() - 1);
  fmt::print("saturation: {} DN{}\n", t.model.saturation_dn,
             t.full_well_e ? fmt::format(", full well {} e-", text_of(t.full_well_e)) : "");
  if (t.lamp_flicker) fmt::print("lamp: {} % from frame to frame\n", text_of(t.lamp_flicker, 100));
  const std::size_t n_bad = t.n_hot + t.n_dead + t.n_erratic;
  const double n_values = static_cast<double>(t.width) * t.height * acquire::values_per_pixel(t.layout);
  fmt::print("bad values: {} ({:.3g} %): {} hot, {} dead, {} erratic\n", n_bad, 100 * static_cast<double>(n_bad) / n_values, t.n_hot,
             t.n_dead, t.n_erratic);
  for (const std::string& note : t.notes) fmt::print("note: {}\n", note);
}

/// The line of all channels at a point, DN^2.
double line_at(const PhotonTransfer& t, const TransferPoint& p) {
  const double read = t.all.read_noise_dn ? t.all.read_noise_dn->value : 0;
  return read * read + p.mean / t.model.gain_e_per_dn + t.model.relative_noise * t.model.relative_noise * p.light_square;
}

/// Columns of the points of one channel, fitted or left out, that a logarithmic plot can show: mean, variance, its standard error, and
/// variance and error relative to the line, per cent.
std::vector<std::vector<double>> columns_of(const PhotonTransfer& t, int channel, bool fitted) {
  std::vector<std::vector<double>> columns(5);
  for (const TransferPoint& p : t.points) {
    if (p.channel != channel || (p.use == TransferPoint::Use::fitted) != fitted || !(p.mean > 0) || !(p.variance > 0)) continue;
    const double line = line_at(t, p);
    const double row[] = {p.mean, p.variance, p.sigma, 100 * (p.variance / line - 1), 100 * p.sigma / line};
    for (std::size_t i = 0; i < columns.size(); ++i) columns[i].push_back(row[i]);
  }
  return columns;
}

/// One block of data per channel and use, `names` in the order of drawing: "fitted0", ..., "left0", ...
std::string plot_blocks(const PhotonTransfer& t, std::vector<std::pair<std::string, std::size_t>>& names) {
  std::string data;
  for (const bool fitted : {true, false})
    for (std::size_t c = 0; c < t.channels.size(); ++c) {
      const auto columns = columns_of(t, static_cast<int>(c), fitted);
      if (columns[0].empty()) continue;
      names.emplace_back((fitted ? "fitted" : "left") + std::to_string(c), c);
      data += plot_data(names.back().first, columns);
    }
  return data;
}

/// Curve above, deviation from the line below: on the logarithmic axis error bars would be too small to see.
std::string plot_script(const PhotonTransfer& t) {
  std::vector<std::pair<std::string, std::size_t>> names;
  const std::string data = plot_blocks(t, names);
  if (names.empty()) return {};
  const bool several = t.channels.size() > 1;
  const char* const colours[] = {"vermilion", "green", "blue"};
  std::string curve, deviation, left_title = "title 'left out'";
  const auto add = [](std::string& plot, const std::string& text) { plot += (plot.empty() ? "plot " : ", \\\n  ") + text; };
  for (const auto& [name, c] : names) {
    const bool fitted = name[0] == 'f';
    const std::string look = fitted ? fmt::format("pt 7 ps 0.6 lc rgb {}", several ? colours[c] : "blue") : "pt 6 ps 0.8 lc rgb grey";
    const std::string title = fitted ? "title " + plot_text(several ? channel_names(t)[c] : "measured") : left_title;
    if (!fitted) left_title = "notitle";
    add(curve, fmt::format("${} {} {} {}", name, fitted ? "using 1:2:3 with yerrorbars" : "using 1:2 with points", look, title));
    if (fitted) add(deviation, fmt::format("${} using 1:4:5 with yerrorbars {} notitle", name, look));
  }
  if (t.gain_measured) {
    const double read = t.all.read_noise_dn ? t.all.read_noise_dn->value : 0;
    add(curve, fmt::format("{} + x / {} + ({} * x)**2 with lines lw 1.5 lc rgb black title {}", read * read, t.model.gain_e_per_dn,
                           t.model.relative_noise, plot_text("line: " + text_of(t.all.gain_e_per_dn) + " e-/DN")));
    if (read > 0) add(curve, fmt::format("{} with lines dt 2 lc rgb grey title {}", read * read, plot_text("read noise: " + text_of(t.all.read_noise_e) + " e-")));
  }
  std::string script = data + "set logscale xy\nset format xy '10^{%L}'\nset samples 400\nset key top left\nset ylabel 'temporal variance, DN^2'\n";
  const std::string x_label = "set xlabel 'mean signal above black, DN'\n";
  if (!t.gain_measured || deviation.empty()) return script + x_label + curve + "\n";
  // Both with the same x axis: that of the curve, which has the more points.
  script += "set multiplot\nset lmargin 10\nset rmargin 3\nset bmargin at screen 0.36\nset format x ''\n" + curve + "\n";
  script += "set xrange [GPVAL_X_MIN:GPVAL_X_MAX]\nset tmargin at screen 0.33\nset bmargin at screen 0.11\nunset logscale y\nset format x '10^{%L}'\n"
            "set format y '%g'\nset ylabel 'off the line, %'\nset yrange [*:*]\n" + x_label;
  return script + deviation + ", \\\n  0 with lines lc rgb black notitle\nunset multiplot\n";
}

std::vector<std::string> input_files(const Options& o) {
  std::vector<std::string> files;
  for (const std::string& list : {o.darks, o.flats}) {
    if (list.empty()) continue;
    files.push_back(list);
    for (const calib::ListedFrame& frame : calib::read_frame_list(list)) files.push_back(frame.file.string());
  }
  if (o.response != "linear") files.push_back(o.response);
  return files;
}

void run(Options o, const Context& context) {
  if (o.darks.empty() && o.flats.empty())
    throw Error(ErrorCode::usage, "calibrate noise: expected --darks list.csv, --flats list.csv or both");
  if (!o.plot.empty()) check_plot_name(o.plot);
  const acquire::PixelLayout layout = acquire::pixel_layout_from_name(o.layout);
  if (o.response != "linear") o.measurement.response = calib::read_response(o.response);
  if (o.keep_shading) o.measurement.shading = calib::PhotonTransferOptions::Shading::kept;
  const auto series = [&](const std::string& list) {
    return list.empty() ? calib::FrameSeries{} : calib::listed_series(list, o.bits, layout);
  };
  const PhotonTransfer t = calib::photon_transfer(series(o.darks), series(o.flats), o.measurement, stderr_progress(context));
  calib::write_noise(o.output, t, provenance_json(context, input_files(o)));
  if (!o.maps.empty() && !t.maps.empty()) calib::write_sensor_maps(o.maps, t.maps);
  if (!o.plot.empty()) {
    const std::string script = plot_script(t);
    if (script.empty()) throw Error(ErrorCode::input, fmt::format("{}: no point of the curve is above 0, there is nothing to plot", o.plot));
    gnuplot(script, o.plot);
  }
  if (context.json) {
    // What the file says, and where it is.
    auto j = nlohmann::ordered_json::parse(brdf::read_text(o.output));
    j["file"] = o.output;
    if (!o.maps.empty() && !t.maps.empty()) j["maps"] = o.maps;
    return print_json(j);
  }
  print_result(t, o);
  fmt::print("noise: {}\n", o.output);
  if (!o.maps.empty()) fmt::print("maps: {}\n", t.maps.empty() ? "not written, there is nothing to correct" : o.maps);
  if (!o.plot.empty()) fmt::print("plot: {}\n", o.plot);
}

}  // namespace

void add_calibrate_noise(CLI::App& calibrate, Context& context) {
  auto o = std::make_shared<Options>();
  CLI::App* command = calibrate.add_subcommand(
      "noise", "dark frames and pairs of flats -> noise model with standard errors, maps of the sensor (photon transfer, EMVA 1288)");
  command->add_option("--darks", o->darks, "CSV file,exposure_s: lens covered, two or more frames at each of several times");
  command->add_option("--flats", o->flats, "CSV file,exposure_s: evenly lit, pairs of equal frames in a row, many levels up to saturation");
  command->add_option("--bits", o->bits, "bits of a value, right-aligned in the file")->capture_default_str()->check(CLI::Range(8, 16));
  command->add_option("--layout", o->layout, "of single-channel files: mono, rggb, grbg, gbrg, bggr")->capture_default_str();
  command->add_option("--response", o->response, "linear or the JSON file of a curve")->capture_default_str();
  command->add_option("--black-level", o->measurement.black_level_dn, "DN; needed where there are no dark frames")->check(CLI::Range(0.0, 65535.0));
  command->add_option("--saturation", o->measurement.saturation_dn, "DN from which values are clipped, default: found from the flats")
      ->check(CLI::Range(0.0, 65535.0));
  command->add_flag("--keep-shading", o->keep_shading,
                    "the flats saw a uniform source through the lens: keep vignetting in the map (sensor.vignetting must then be 0); default: "
                    "the smooth part is lamp and lens and is divided out");
  command->add_option("-o,--output", o->output, "noise.json to write")->required();
  command->add_option("--maps", o->maps, "EXR to write: offset, dark rate, sensitivity and bad values");
  command->add_option("--plot", o->plot, "SVG or PNG to write: the photon-transfer curve");
  add_json_option(*command, context);
  command->callback([o, &context] { run(*o, context); });
}

}  // namespace lacquer::tools
