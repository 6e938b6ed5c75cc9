#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "fit_test_support.h"
#include "libbrdf/error.h"
#include "libfit/observations.h"

namespace lacquer::test {
namespace {

TEST(Fit, TheSameTableGivesTheSameBytesForAnyNumberOfThreads) {
  const brdf::HalfAngleTable table = with_noise(table_of(paint("bmw-339")), 0.05, 1e-3, 2);
  const auto bytes = [&](unsigned threads) {
    return fit::fit_to_json(fit::fit_table(table, {.n_starts = 3, .max_cells = 10000, .threads = threads}),
                            true, "{}");
  };
  const std::string one = bytes(1);
  EXPECT_EQ(one, bytes(2));
  EXPECT_EQ(one, bytes(7));
}

TEST(Fit, CellsWithoutMeaningAreCountedAndLeftOut) {
  const brdf::CookTorrance truth = paint("blue-matte");
  brdf::HalfAngleTable table = table_of(truth);
  auto& red = table.channels[0];
  const auto nan = std::numeric_limits<float>::quiet_NaN();
  std::vector<std::size_t> cells;
  for (std::size_t i = 1000000; cells.size() < 6; ++i)
    if (red.origin[i] == brdf::CellOrigin::measured &&
        brdf::TableGrid::reachable(brdf::TableGrid::cell(i), 0.1))
      cells.push_back(i);
  red.mean[cells[0]] = nan;
  red.mean[cells[1]] = -1;  // without a variance
  red.mean[cells[2]] = 0;
  red.variance[cells[3]] = -1;
  red.theta_h[cells[4]] = nan;
  red.origin[cells[5]] = brdf::CellOrigin::filled;
  const fit::FitResult fit = fit::fit_table(table, {.max_cells = 10000, .model_sigma = 1e-4});
  EXPECT_EQ(fit.left_out.not_finite, 3u);
  EXPECT_EQ(fit.left_out.not_positive, 2u);
  EXPECT_EQ(fit.left_out.not_measured, 1u);
  EXPECT_LE(mean_abs_log(fit.model, truth), 1e-5);
}

TEST(Fit, MirroredAndFilledCellsCarryNoWeight) {
  const brdf::CookTorrance truth = paint("opel-titan");
  brdf::HalfAngleTable table = table_of(truth);
  for (auto& channel : table.channels)
    for (std::size_t i = 0; i < channel.mean.size(); ++i) {
      if (channel.origin[i] == brdf::CellOrigin::empty || i % 3 != 0) continue;
      channel.origin[i] = i % 2 ? brdf::CellOrigin::symmetric : brdf::CellOrigin::modelled;
      channel.mean[i] = 1000;
    }
  const fit::FitResult fit = fit::fit_table(table, {.max_cells = 10000, .model_sigma = 1e-4});
  EXPECT_LE(mean_abs_log(fit.model, truth), 1e-5);
}

TEST(Fit, AChannelWithoutDataIsReportedAsUndetermined) {
  const brdf::CookTorrance truth = paint("polaris-silber");
  brdf::HalfAngleTable table = table_of(truth);
  for (float& value : table.channels[2].mean) value = 0;
  const fit::FitResult fit = fit::fit_table(table, {.max_cells = 10000, .model_sigma = 1e-4});
  for (const fit::Parameter& p : fit.parameters) {
    const bool blue = p.name.size() > 2 && p.name.substr(p.name.size() - 2) == ".b";
    EXPECT_EQ(p.determined, !blue) << p.name;
    if (blue) {
      EXPECT_EQ(p.sigma, 0) << p.name;
    }
  }
  EXPECT_NEAR(fit.model.lobes[2].m, 0.013, 1e-6);
}

TEST(Fit, AStarkEnergyExcessIsPulledBackOnlyOnAnAbsoluteScale) {
  brdf::CookTorrance truth = diffuse({0.9, 0.9, 0.9});
  truth.lobes = {{.ks = {0.3, 0.3, 0.3}, .m = 0.1, .r = 1.0}};  // reflects 2.1 times what it gets
  brdf::HalfAngleTable table = table_of(truth);
  fit::FitOptions options{.n_lobes = 1, .max_cells = 5000};
  const fit::FitResult absolute = fit::fit_table(table, options);
  table.absolute_scale = false;
  const fit::FitResult relative = fit::fit_table(table, options);
  EXPECT_NEAR(relative.energy, 2.1, 0.01);
  EXPECT_LT(absolute.energy, 2.0);
  options.energy_weight = 0;
  table.absolute_scale = true;
  EXPECT_NEAR(fit::fit_table(table, options).energy, 2.1, 0.01);
}

TEST(Fit, TooFewCellsAreAnErrorThatSaysHowMany) {
  try {
    fit::fit_table(brdf::HalfAngleTable(3));
    FAIL() << "an empty table was fitted";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ErrorCode::input);
    EXPECT_NE(std::string(e.what()).find("0 usable values are too few for 3 parameters"), std::string::npos)
        << e.what();
  }
}

TEST(Fit, TablesOfTheWrongShapeAreRefused) {
  brdf::HalfAngleTable two(2);
  EXPECT_THROW(fit::fit_table(two), Error);
  brdf::HalfAngleTable cut(3);
  cut.channels[1].mean.resize(10);
  EXPECT_THROW(fit::fit_table(cut), Error);
}

TEST(Fit, OptionsOutOfRangeNameTheField) {
  const auto complaint = [](const fit::FitOptions& options) -> std::string {
    try {
      options.validate();
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::usage);
      return e.what();
    }
    return "";
  };
  EXPECT_EQ(complaint({}), "");
  EXPECT_NE(complaint({.n_lobes = 6}).find("n_lobes"), std::string::npos);
  EXPECT_NE(complaint({.n_starts = 0}).find("n_starts"), std::string::npos);
  EXPECT_NE(complaint({.max_cells = 0}).find("max_cells"), std::string::npos);
  EXPECT_NE(complaint({.model_sigma = 0}).find("model_sigma"), std::string::npos);
  EXPECT_NE(complaint({.min_cosine = std::nan("")}).find("min_cosine"), std::string::npos);
  EXPECT_NE(complaint({.robust_scale = -1}).find("robust_scale"), std::string::npos);
  EXPECT_NE(complaint({.max_iterations = 0}).find("max_iterations"), std::string::npos);
}

TEST(Fit, RunningOutOfIterationsIsAStatusNotAnError) {
  const brdf::HalfAngleTable table = with_noise(table_of(paint("blue")), 0.05, 0, 1);
  const fit::FitResult fit = fit::fit_table(table, {.max_cells = 2000, .max_iterations = 1});
  EXPECT_FALSE(fit.converged);
  EXPECT_FALSE(fit.message.empty());
}

TEST(Fit, ProgressComesFromTheCallingThreadAndMayStopTheWork) {
  const brdf::HalfAngleTable table = table_of(paint("blue"));
  std::size_t calls = 0, last_done = 0, last_total = 1;
  fit::fit_table(table, {.max_cells = 2000}, [&](const std::string&, std::size_t done, std::size_t total) {
    ++calls;
    last_done = done, last_total = total;
  });
  EXPECT_GT(calls, 1u);
  EXPECT_EQ(last_done, last_total);
  const auto stop = [](const std::string&, std::size_t, std::size_t) {
    throw Error(ErrorCode::interrupted, "stop");
  };
  EXPECT_THROW(fit::fit_table(table, {.max_cells = 2000}, stop), Error);
}

TEST(Choice, IsSpreadOverTheGridAndKeepsSparseGroupsWhole) {
  fit::UsableCells usable;
  std::vector<std::uint32_t>& cells = usable.cells;
  for (std::uint32_t i = 0; i < brdf::TableGrid::n_cells; ++i) {
    // Rows below 12 are sparse, as where a clear coat's peak was hit by few pixels.
    if (brdf::TableGrid::cell(i).theta_h >= 12 || i % 45 == 0) cells.push_back(i);
  }
  usable.channels.assign(cells.size(), 7);
  const auto sparse = [](std::uint32_t i) { return brdf::TableGrid::cell(i).theta_h < 12; };
  const auto chosen = fit::stratified_choice(usable, 50000).cells;
  EXPECT_EQ(chosen.size(), 50000u);
  EXPECT_TRUE(std::is_sorted(chosen.begin(), chosen.end()));
  EXPECT_EQ(std::adjacent_find(chosen.begin(), chosen.end()), chosen.end()) << "no cell twice";
  EXPECT_EQ(std::count_if(chosen.begin(), chosen.end(), sparse),
            std::count_if(cells.begin(), cells.end(), sparse));
  std::vector<int> per_phi(10);
  for (const auto i : chosen)
    if (!sparse(i)) ++per_phi[static_cast<std::size_t>(brdf::TableGrid::cell(i).phi_d / 18)];
  const int full_rows = static_cast<int>(50000 - std::count_if(chosen.begin(), chosen.end(), sparse));
  for (const int n : per_phi) EXPECT_NEAR(n, full_rows / 10, full_rows / 200) << "every azimuth is seen";

  for (const std::size_t wanted : {1u, 17u, 89u, 1000u, 8099u, 8101u}) {
    const auto few = fit::stratified_choice(usable, wanted).cells;
    EXPECT_LE(few.size(), wanted);
    EXPECT_GE(few.size(), wanted * 9 / 10);
  }
  EXPECT_EQ(fit::stratified_choice(usable, cells.size()).cells, cells);
}

TEST(FitJson, HoldsThePaintEntryAtTopLevelAndEverythingThatJudgesIt) {
  const brdf::HalfAngleTable table = table_of(paint("blue-matte"));
  const fit::FitResult fit = fit::fit_table(table, {.max_cells = 5000, .model_sigma = 1e-4});
  TemporaryFolder folder;
  fit::write_fit(folder / "fit.json", fit, true, R"({"command": "lacquer fit x"})");

  const brdf::CookTorrance model = brdf::read_model(folder / "fit.json");
  for (std::size_t l = 0; l < 3; ++l) {
    EXPECT_EQ(model.lobes[l].m, fit.model.lobes[l].m);
    EXPECT_EQ(model.lobes[l].ks, fit.model.lobes[l].ks);
  }
  EXPECT_EQ(model.kd, fit.model.kd);

  const auto j = nlohmann::json::parse(brdf::read_text(folder / "fit.json"));
  EXPECT_EQ(j.at("version"), 1);
  EXPECT_EQ(j.at("scale"), "absolute");
  EXPECT_EQ(j.at("parameters").size(), 18u);
  EXPECT_EQ(j.at("parameters").at(0).at("name"), "kd.r");
  EXPECT_EQ(j.at("covariance").size(), 18u);
  EXPECT_EQ(j.at("covariance").at(17).size(), 18u);
  for (std::size_t k = 0; k < 18; ++k) {
    const double sigma = j.at("parameters").at(k).at("sigma"), variance = j.at("covariance").at(k).at(k);
    EXPECT_NEAR(variance, sigma * sigma, 1e-12 * variance);
  }
  EXPECT_GE(j.at("candidates").size(), 1u);
  EXPECT_EQ(j.at("provenance").at("command"), "lacquer fit x");
  EXPECT_TRUE(j.at("options").at("n_lobes").is_null());
  EXPECT_EQ(j.at("correlation").at(3).at(3), 1.0);
  EXPECT_GE(j.at("minima").size(), 1u);
  EXPECT_EQ(j.at("candidates").at(0).at("criterion"), 0.0);
  EXPECT_EQ(j.at("candidates").at(0).at("n_parameters"), 18);
  EXPECT_THROW(fit::fit_to_json(fit, true, "{broken"), Error);
}

}  // namespace
}  // namespace lacquer::test
