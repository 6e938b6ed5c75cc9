#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "libacquire/back_ends.h"
#include "libbrdf/error.h"
#include "tools/json_output.h"

namespace lacquer::tools {

namespace {

struct Listing {
  const char* kind;
  std::string back_end;
  bool built;
  std::string problem;  ///< of the search as a whole
  std::vector<acquire::FoundDevice> devices;
};

template <typename Table>
void look_for(const char* kind, const Table& table, std::vector<Listing>& all) {
  for (const auto& row : table) {
    if (row.open && !row.find) continue;  // nothing that could be found
    Listing listing{kind, std::string(row.name), row.open != nullptr, {}, {}};
    try {
      if (row.find) listing.devices = row.find();
    } catch (const Error& e) {
      listing.problem = e.what();
    }
    all.push_back(std::move(listing));
  }
}

nlohmann::ordered_json to_json(const std::vector<Listing>& all, const Context& context) {
  nlohmann::ordered_json j = json_result(context);
  j["back_ends"] = nlohmann::ordered_json::array();
  for (const Listing& listing : all) {
    nlohmann::ordered_json b;
    b["kind"] = listing.kind;
    b["back_end"] = listing.back_end;
    b["in_this_build"] = listing.built;
    if (!listing.problem.empty()) b["problem"] = listing.problem;
    b["devices"] = nlohmann::ordered_json::array();
    for (const acquire::FoundDevice& device : listing.devices) {
      nlohmann::ordered_json d;
      d["id"] = device.id;
      d["description"] = device.description;
      if (!device.formats.empty()) d[std::string_view(listing.kind) == "lights" ? "lines" : "formats"] = device.formats;
      if (device.limits) d["exposure_s"] = {device.limits->min_exposure_s, device.limits->max_exposure_s};
      if (!device.problem.empty()) d["problem"] = device.problem;
      b["devices"].push_back(std::move(d));
    }
    j["back_ends"].push_back(std::move(b));
  }
  return j;
}

std::string to_text(const std::vector<Listing>& all) {
  std::string text;
  std::size_t n_devices = 0;
  for (const Listing& listing : all) {
    const std::string title = fmt::format("{:<10} {:<7}", listing.kind, listing.back_end);
    if (!listing.built) text += title + " not in this build\n";
    if (!listing.problem.empty()) text += title + " " + listing.problem + "\n";
    for (const acquire::FoundDevice& device : listing.devices) {
      ++n_devices;
      text += fmt::format("{} {:<20} {}\n", title, device.id, device.problem.empty() ? device.description : device.problem);
      const std::string indent(19, ' ');
      if (device.limits) text += fmt::format("{}exposure {:g} to {:g} ms\n", indent, device.limits->min_exposure_s * 1e3, device.limits->max_exposure_s * 1e3);
      for (const std::string& format : device.formats) text += indent + format + "\n";
    }
  }
  if (n_devices == 0) text += "no camera, no turntable and no GPIO chip is connected\n";
  return text;
}

}  // namespace

void add_devices(CLI::App& app, Context& context) {
  auto* command = app.add_subcommand("devices", "list cameras, turntables and GPIO chips: ids for a rig file, formats, exposures");
  add_json_option(*command, context);
  command->callback([&context] {
    std::vector<Listing> all;
    look_for("camera", acquire::camera_back_ends(), all);
    look_for("turntable", acquire::turntable_back_ends(), all);
    look_for("lights", acquire::lights_back_ends(), all);
    if (context.json)
      print_json(to_json(all, context));
    else
      fmt::print("{}", to_text(all));
  });
}

}  // namespace lacquer::tools
