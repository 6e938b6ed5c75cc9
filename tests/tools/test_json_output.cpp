#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <sstream>

#include "test_support.h"

/// --json of every command that prints a result.
namespace lacquer {
namespace {

using nlohmann::json;

std::string sample(const std::string& name) { return (test::source_dir() / "data-samples" / name).string(); }

/// Names under "Subcommands:" of a help text.
std::vector<std::string> commands_in(const std::string& help) {
  std::vector<std::string> names;
  std::istringstream lines(help.substr(std::min(help.size(), help.find("Subcommands:"))));
  std::string line;
  for (std::getline(lines, line); std::getline(lines, line);)
    if (line.size() > 2 && line[2] != ' ') names.push_back(line.substr(2, line.find(' ', 2) - 2));
  return names;
}

class JsonOutput : public testing::Test {
 protected:
  const test::TemporaryFolder folder_;
  std::string in(const std::string& name) const { return (folder_ / name).string(); }
  /// One object and nothing else on stdout.
  json run(const std::string& arguments) const {
    const auto result = test::run_lacquer("-q " + arguments + " --json");
    EXPECT_EQ(result.exit_code, 0) << arguments << ": " << result.err;
    EXPECT_EQ(result.err, "") << arguments;
    const json j = json::parse(result.out, nullptr, false);
    EXPECT_TRUE(j.is_object()) << arguments << " printed: " << result.out.substr(0, 200);
    return j;
  }
};

TEST_F(JsonOutput, IsAnOptionOfEveryCommand) {
  const auto commands = commands_in(test::run_lacquer("--help").out);
  EXPECT_GT(commands.size(), 12u);
  for (const std::string& command : commands) {
    const std::string help = test::run_lacquer(command + " --help").out;
    const auto parts = commands_in(help);
    if (parts.empty()) EXPECT_NE(help.find("--json"), std::string::npos) << command;
    for (const std::string& part : parts) EXPECT_NE(test::run_lacquer(command + " " + part + " --help").out.find("--json"), std::string::npos) << command << " " << part;
  }
}

TEST_F(JsonOutput, OfEveryStageOfASessionIsOneObject) {
  const std::string rig = sample("tiny-rig.toml"), s = in("s");
  EXPECT_EQ(run("capture " + rig + " --dry-run").at("frames"), 27);
  EXPECT_FALSE(run("capture " + rig + " --check").at("checks").empty());
  EXPECT_EQ(run("capture " + rig + " -o " + s).at("frames"), 27);
  EXPECT_EQ(run("merge " + s).at("views"), 9);
  EXPECT_FALSE(run("calibrate response " + s + " -o " + in("r.json")).at("channels").empty());
  EXPECT_FALSE(run("calibrate geometry " + s).at("parameters").empty());
  EXPECT_EQ(run("calibrate geometry --from-rig " + s).at("geometry"), "rig file");
  EXPECT_GT(run("tabulate " + s).at("samples").at("used"), 10000);
  const json fit = run("fit " + s + "/table.exr --lobes 1 -o " + s + "/fit.json");
  EXPECT_EQ(fit.at("lobes").size(), 1u);
  EXPECT_EQ(run("rerender " + s).at("views").size(), 9u);
  EXPECT_EQ(run("fill " + s + "/table.exr --max-theta-deg 8 -o " + in("filled.exr")).at("channels").size(), 3u);
  EXPECT_GT(run("report " + s + " -o " + in("page.html")).at("bytes"), 100000);
}

TEST_F(JsonOutput, OfCommandsOnBrdfFilesIsOneObject) {
  const std::string a = sample("paints/blue.json"), b = sample("paints/blue-matte.json");
  test::write_file(folder_ / "d.csv", "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg\n10,0,20,180\n95,0,20,180\n");
  EXPECT_GT(run("compare " + a + " " + b).at("metrics").at("mean_abs_log"), 0);
  EXPECT_EQ(run("check " + a + " --resolution 20").at("n_negative"), 0);
  const json values = run("eval " + a + " --directions " + in("d.csv")).at("values");
  ASSERT_EQ(values.size(), 2u);
  EXPECT_GT(values.at(0).at(0), 0);
  EXPECT_EQ(values.at(1), json::array({0.0, 0.0, 0.0}));
  EXPECT_GT(run("convert " + a + " -o " + in("a.mbsdf")).at("bytes"), 1000);
  EXPECT_EQ(run("plot log " + a + " -o " + in("a.svg")).at("kind"), "log");
  EXPECT_TRUE(run("devices").contains("back_ends"));
}

TEST_F(JsonOutput, OfLoosePhotographsIsOneObject) {
  // The tiny session's own frames as loose files: 3 exposures of the first view.
  ASSERT_EQ(test::run_lacquer("-q capture " + sample("tiny-rig.toml") + " -o " + in("s")).exit_code, 0);
  const json session = json::parse(std::ifstream(folder_ / "s/session.json"));
  std::string list = "file,exposure_s\n";
  for (const auto& frame : session.at("views").at(0).at("frames"))
    list += in("s/" + frame.at("file").get<std::string>()) + "," + frame.at("exposure_s").dump() + "\n";
  test::write_file(folder_ / "list.csv", list);
  const json merged = run("merge --frames " + in("list.csv") + " --bits 12 --layout rggb --response linear --black-level 64 --gain 4 --read-noise 5 -o " + in("r.exr"));
  EXPECT_EQ(merged.at("times").at("listed_s").size(), 3u);
  EXPECT_GT(merged.at("image").at("values"), 0);
}

TEST_F(JsonOutput, ColourIsNeverWrittenToAFile) {
  const auto result = test::run_lacquer("check " + in("missing.json"));
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_TRUE(result.err.starts_with("lacquer: ")) << result.err;
  EXPECT_EQ(result.err.find('\x1b'), std::string::npos);
}

}  // namespace
}  // namespace lacquer
