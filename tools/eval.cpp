#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <cstdio>
#include <glm/trigonometric.hpp>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string_view>

#include "libbrdf/brdf.h"
#include "libbrdf/file_error.h"
#include "libbrdf/files.h"
#include "libfit/fitted_model.h"
#include "tools/json_output.h"

namespace lacquer::tools {

namespace {

constexpr std::string_view csv_header = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg";
constexpr std::uint64_t max_csv_bytes = std::uint64_t{1} << 30;

std::string_view trimmed(std::string_view s) {
  const auto begin = s.find_first_not_of(" \t\r"), end = s.find_last_not_of(" \t\r");
  return begin == std::string_view::npos ? std::string_view{} : s.substr(begin, end - begin + 1);
}

/// Unit direction; on or below the horizon from 90 degrees on, where rounding would leave a cosine of 6e-17.
glm::dvec3 direction_from_degrees(double theta, double phi) {
  glm::dvec3 w = brdf::direction(glm::radians(theta), glm::radians(phi));
  if (theta >= 90) w.z = std::min(w.z, 0.0);
  return w;
}

/// `where`: "file:line", for messages.
brdf::Directions parse_row(std::string_view row, const std::string& where) {
  constexpr const char* columns[] = {"theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg"};
  double value[4];
  for (int i = 0; i < 4; ++i) {
    const auto comma = row.find(',');
    if ((comma == std::string_view::npos) != (i == 3)) brdf::fail_file(where, "expected 4 numbers with commas between them");
    std::string_view field = trimmed(row.substr(0, comma));
    if (field.starts_with('+')) field.remove_prefix(1);
    const auto [end, status] = std::from_chars(field.data(), field.data() + field.size(), value[i]);
    if (status != std::errc{} || end != field.data() + field.size() || !std::isfinite(value[i]))
      brdf::fail_file(where, fmt::format("{}: expected a number, got '{}'", columns[i], brdf::printable(std::string(field), 40)));
    if (i % 2 == 0 && !(value[i] >= 0 && value[i] <= 180))
      brdf::fail_file(where, fmt::format("{}: expected 0 to 180 degrees, got {}", columns[i], value[i]));
    row.remove_prefix(comma == std::string_view::npos ? row.size() : comma + 1);
  }
  return {direction_from_degrees(value[0], value[1]), direction_from_degrees(value[2], value[3])};
}

std::vector<brdf::Directions> read_directions(std::istream& in, const std::string& name) {
  std::vector<brdf::Directions> rows;
  std::string line;
  std::size_t number = 0, empty_line = 0;
  while (std::getline(in, line)) {
    ++number;
    std::string_view text = trimmed(line);
    const std::string where = fmt::format("{}:{}", name, number);
    if (number == 1) {
      if (text.starts_with("\xef\xbb\xbf")) text.remove_prefix(3);  // byte order mark, as spreadsheet programs write it
      if (text != csv_header)
        brdf::fail_file(where, fmt::format("expected the header {}, got '{}'", csv_header, brdf::printable(std::string(text), 80)));
    } else if (text.empty()) {
      if (empty_line == 0) empty_line = number;  // fine at the end only
    } else {
      if (empty_line != 0) brdf::fail_file(fmt::format("{}:{}", name, empty_line), "expected 4 numbers, got an empty line");
      rows.push_back(parse_row(text, where));
    }
  }
  if (number == 0) brdf::fail_file(name, fmt::format("is empty, expected the header {}", csv_header));
  return rows;
}

std::vector<brdf::Directions> read_directions(const std::string& name) {
  if (name == "-") return read_directions(std::cin, "stdin");
  std::istringstream in(brdf::read_text(name, max_csv_bytes));
  return read_directions(in, name);
}

/// One line per direction; returns how many had no value. `fit`: its standard errors are three more columns.
std::size_t print_values(const brdf::Brdf& brdf, const std::vector<brdf::Directions>& directions, const std::optional<fit::FittedModel>& fit) {
  std::size_t n_undefined = 0;
  fmt::memory_buffer out;
  fmt::format_to(std::back_inserter(out), "r,g,b{}\n", fit ? ",sigma_r,sigma_g,sigma_b" : "");
  for (const auto& d : directions) {
    const auto f = brdf.value(d);
    if (!f) {
      fmt::format_to(std::back_inserter(out), ",,{}\n", fit ? ",,," : "");
      ++n_undefined;
      continue;
    }
    fmt::format_to(std::back_inserter(out), "{:.9g},{:.9g},{:.9g}", f->r, f->g, f->b);
    if (fit) {
      const bool above = d.wi.z > 0 && d.wo.z > 0;
      const glm::dvec3 sigma = above ? fit::value_sigma(*fit, brdf::half_angle_cosines(d)) : glm::dvec3(0);
      fmt::format_to(std::back_inserter(out), ",{:.4g},{:.4g},{:.4g}", sigma.r, sigma.g, sigma.b);
    }
    out.push_back('\n');
  }
  if (std::fwrite(out.data(), 1, out.size(), stdout) != out.size() || std::fflush(stdout) != 0)
    throw Error(ErrorCode::file, "stdout: the values could not be written");
  return n_undefined;
}

/// "values": [r, g, b] per direction or null; "sigma" likewise.
std::size_t print_values_json(const brdf::Brdf& brdf, const std::vector<brdf::Directions>& directions, const std::optional<fit::FittedModel>& fit, nlohmann::ordered_json j) {
  std::size_t n_undefined = 0;
  j["unit"] = "1/sr";
  auto& values = j["values"] = nlohmann::ordered_json::array();
  for (const auto& d : directions) {
    const auto f = brdf.value(d);
    values.push_back(f ? nlohmann::ordered_json{f->r, f->g, f->b} : nlohmann::ordered_json());
    n_undefined += !f;
    if (!fit) continue;
    const glm::dvec3 sigma = d.wi.z > 0 && d.wo.z > 0 ? fit::value_sigma(*fit, brdf::half_angle_cosines(d)) : glm::dvec3(0);
    j["sigma"].push_back({sigma.r, sigma.g, sigma.b});
  }
  print_json(j);
  return n_undefined;
}

}  // namespace

void add_eval(CLI::App& app, Context& context) {
  auto* command = app.add_subcommand("eval", "values of a BRDF in 1/sr, without the cosine, as CSV r,g,b on stdout");
  struct Options {
    std::string input, directions;
    bool sigma = false;
  };
  const auto options = std::make_shared<Options>();
  command->add_option("INPUT", options->input, "BRDF file: table.exr, fit.json, MERL .binary, RGL .bsdf")->required();
  command->add_option("--directions", options->directions, fmt::format("CSV with the header {}; - for stdin", csv_header))->required();
  command->add_flag("--sigma", options->sigma, "standard errors too, sigma_r,sigma_g,sigma_b; of a fit.json only");
  add_json_option(*command, context);
  command->callback([options, &context] {
    const auto brdf = brdf::load_brdf(options->input);
    const auto directions = read_directions(options->directions);
    std::optional<fit::FittedModel> fit;
    if (options->sigma) fit = fit::read_fit(options->input);
    const std::size_t n_undefined = context.json ? print_values_json(*brdf, directions, fit, json_result(context, {options->input})) : print_values(*brdf, directions, fit);
    if (n_undefined > 0 && !context.quiet)
      fmt::print(stderr, "{} of {} directions: {} says nothing there, the fields are empty\n", n_undefined, directions.size(),
                 brdf->description());
  });
}

}  // namespace lacquer::tools
