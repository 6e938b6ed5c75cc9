#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "libbrdf/brdf.h"
#include "libbrdf/files.h"
#include "libbrdf/table.h"
#include "test_support.h"

namespace lacquer::test {
namespace {

std::string paint_file(const std::string& name) {
  return (source_dir() / "data-samples" / "paints" / (name + ".json")).string();
}

TEST(FitCommand, AModelGoesInAndTheSameModelComesOutWithErrors) {
  TemporaryFolder folder;
  const std::string output = (folder / "fit.json").string();
  const CommandResult run = run_lacquer("-q fit " + paint_file("opel-titan") + " -o " + output +
                                        " --max-cells 10000 --model-sigma 1e-4");
  EXPECT_EQ(run.exit_code, 0) << run.err;
  EXPECT_EQ(run.err, "");
  for (const char* text : {"kd.r", "ks3.b", "m3", "mean |ln|", "cosine RMS", "cube root", "dE2000", "cells", "minimum 1", "time", " ± "})
    EXPECT_NE(run.out.find(text), std::string::npos) << text << "\n" << run.out;
  const brdf::CookTorrance truth = brdf::read_model(paint_file("opel-titan")), fit = brdf::read_model(output);
  for (std::size_t l = 0; l < 3; ++l) {
    EXPECT_NEAR(fit.lobes[l].m, truth.lobes[l].m, 1e-5 * truth.lobes[l].m);
    EXPECT_NEAR(fit.lobes[l].r, truth.lobes[l].r, 1e-3 * truth.lobes[l].r);
  }
}

TEST(FitCommand, JsonOnStdoutIsWhatGoesToTheFile) {
  TemporaryFolder folder;
  const std::string output = (folder / "fit.json").string();
  const CommandResult run =
      run_lacquer("-q fit " + paint_file("blue") + " --json --lobes 2 --max-cells 5000 -o " + output);
  ASSERT_EQ(run.exit_code, 0) << run.err;
  EXPECT_EQ(run.out, brdf::read_text(output));
  const auto j = nlohmann::json::parse(run.out);
  EXPECT_EQ(j.at("lobes").size(), 2u);
  EXPECT_EQ(j.at("options").at("max_cells"), 5000);
  EXPECT_EQ(j.at("provenance").at("inputs").size(), 1u);
  for (const char* metric : {"mean_abs_log", "cosine_rms", "cube_root_rms", "delta_e_2000_mean", "probe_delta_e_2000_mean", "delta_e_2000_of_errors"}) {
    EXPECT_GE(j.at("metrics").at(metric).get<double>(), 0) << metric;
    EXPECT_LT(j.at("metrics").at(metric).get<double>(), 0.5) << metric;
  }
}

TEST(FitCommand, JsonOfSeveralInputsIsAListInTheirOrder) {
  const CommandResult run = run_lacquer("-q fit " + paint_file("white") + " " + paint_file("blue") + " --json --lobes 1 --max-cells 3000");
  ASSERT_EQ(run.exit_code, 0) << run.err;
  const auto j = nlohmann::json::parse(run.out);
  ASSERT_TRUE(j.is_array());
  ASSERT_EQ(j.size(), 2u);
  EXPECT_GT(j[0].at("kd").at(0).get<double>(), 0.4) << "white";
  EXPECT_LT(j[1].at("kd").at(0).get<double>(), 0.05) << "blue";
}

TEST(FitCommand, SeveralPaintsGiveOneTableInTheirOrder) {
  TemporaryFolder folder;
  const auto table = [&](const std::string& extension) {
    const std::string file = (folder / ("paints." + extension)).string();
    const CommandResult run = run_lacquer("-q fit " + paint_file("white") + " " + paint_file("blue") + " --max-cells 3000 --lobes 2 --table " + file +
                                          " -o " + folder.path().string());
    EXPECT_EQ(run.exit_code, 0) << run.err;
    return brdf::read_text(file);
  };
  const std::string csv = table("csv");
  EXPECT_EQ(csv.substr(0, 80), "paint,structure,mean_abs_log,shared_error,reduced_chi2,kd.r,kd.r_sigma,kd.g,kd.g");
  EXPECT_LT(csv.find("\nwhite,2 lobes,"), csv.find("\nblue,2 lobes,"));
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 3);
  EXPECT_EQ(csv, table("csv")) << "the same bytes again";
  EXPECT_NE(table("md").find("| white | r | "), std::string::npos);
  EXPECT_NE(table("tex").find("\\begin{tabular}{llrrrrrrrr}"), std::string::npos);
  EXPECT_EQ(brdf::read_model(folder / "white.json").lobes.size(), 2u);
  EXPECT_EQ(run_lacquer("fit " + paint_file("white") + " --table paints.xls").exit_code, 2);
}

TEST(EvalCommand, StandardErrorsOfAFitAreThreeMoreColumns) {
  TemporaryFolder folder;
  const std::string fit = (folder / "fit.json").string(), directions = (folder / "d.csv").string();
  ASSERT_EQ(run_lacquer("-q fit " + paint_file("blue") + " --max-cells 3000 --lobes 1 -o " + fit).exit_code, 0);
  write_file(folder / "d.csv", "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg\n30,0,30,180\n95,0,10,0\n");
  const CommandResult run = run_lacquer("eval " + fit + " --sigma --directions " + directions);
  ASSERT_EQ(run.exit_code, 0) << run.err;
  EXPECT_EQ(run.out.find("r,g,b,sigma_r,sigma_g,sigma_b\n"), 0u) << run.out;
  EXPECT_NE(run.out.find("0,0,0,0,0,0\n"), std::string::npos) << run.out;
  EXPECT_EQ(run_lacquer("eval " + paint_file("blue") + " --sigma --directions " + directions).exit_code, 1);
}

TEST(FitCommand, BadInputIsOneLineAndExitOne) {
  TemporaryFolder folder;
  const auto expect_one_line = [](const std::string& arguments, int exit_code, const std::string& text) {
    const CommandResult run = run_lacquer(arguments);
    EXPECT_EQ(run.exit_code, exit_code) << arguments;
    EXPECT_NE(run.err.find(text), std::string::npos) << run.err;
    if (exit_code == 1) {
      EXPECT_EQ(std::count(run.err.begin(), run.err.end(), '\n'), 1) << run.err;
    }
    EXPECT_EQ(run.out, "");
  };
  expect_one_line("fit " + (folder / "missing.exr").string(), 1, "missing.exr");
  write_file(folder / "noise.bin", "neither a table nor a model");
  expect_one_line("fit " + (folder / "noise.bin").string(), 1, "noise.bin");
  brdf::write_table(folder / "empty.exr", brdf::HalfAngleTable(1));
  expect_one_line("fit " + (folder / "empty.exr").string(), 1, "too few");
  expect_one_line("fit " + paint_file("blue") + " --lobes 9", 2, "n_lobes");
  expect_one_line("fit " + paint_file("blue") + " --max-theta-deg 95", 2, "--max-theta-deg");
  expect_one_line("fit", 2, "TABLE");
}

TEST(FitCommand, OfATableWithAnEstimatedGeometryItIsSaidWhatTheErrorsLack) {
  TemporaryFolder folder;
  brdf::HalfAngleTable table = brdf::tabulate_brdf(*brdf::load_brdf(paint_file("blue")), 0.1);
  table.channels.resize(1);
  const auto output_of_fit = [&](const std::string& provenance) {
    table.provenance_json = provenance;
    brdf::write_table(folder / "table.exr", table);
    const CommandResult run = run_lacquer("-q fit --lobes 1 --max-cells 1000 " + (folder / "table.exr").string());
    EXPECT_EQ(run.exit_code, 0) << run.err;
    return run.out;
  };
  EXPECT_NE(output_of_fit(R"({"geometry_sigma": {"half_vector_rad": 0.001, "light_distance": 0.002}})").find("lacquer fit SESSION --samples"), std::string::npos);
  EXPECT_EQ(output_of_fit("{}").find("--samples"), std::string::npos);
}

TEST(FitCommand, SamplesOfASessionAgreeWithItsTable) {
  TemporaryFolder folder;
  const std::string session = (folder / "session").string(), output = (folder / "samples.json").string();
  ASSERT_EQ(run_lacquer("-q measure --no-report " + (source_dir() / "data-samples" / "tiny-rig.toml").string() + " -o " + session).exit_code, 0);
  const CommandResult run = run_lacquer("-q fit --samples " + session + " -o " + output);
  ASSERT_EQ(run.exit_code, 0) << run.err;
  EXPECT_NE(run.out.find("samples      "), std::string::npos) << run.out;
  const auto samples = nlohmann::json::parse(brdf::read_text(output)), table = nlohmann::json::parse(brdf::read_text(folder / "session" / "fit.json"));
  ASSERT_EQ(samples.at("parameters").size(), table.at("parameters").size());
  for (std::size_t k = 0; k < samples["parameters"].size(); ++k) {
    const auto &s = samples["parameters"][k], &t = table["parameters"][k];
    const double sigma = std::max(s.at("sigma").get<double>(), t.at("sigma").get<double>());
    EXPECT_LE(std::abs(s.at("value").get<double>() - t.at("value").get<double>()), 3 * sigma) << s.at("name");
  }
  for (const auto& [name, value] : samples.at("metrics").items()) EXPECT_TRUE(table.at("metrics").contains(name)) << "measure writes it too: " << name;
  const CommandResult missing = run_lacquer("-q fit --samples " + (folder / "nothing").string());
  EXPECT_EQ(missing.exit_code, 1);
  EXPECT_NE(missing.err.find("table.exr"), std::string::npos) << missing.err;
}

}  // namespace
}  // namespace lacquer::test
