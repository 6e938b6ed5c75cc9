#include <cmath>

#include "libbrdf/error.h"
#include "libcalib/response.h"
#include "simulated_bracket.h"
#include "test_support.h"

namespace lacquer::calib {
namespace {

using acquire::RawFrame;
using test::SensorTruth;

/// Gamma 2.2, with `shoulder` also bent like film: x -> u = x^(1 / 2.2), v ~ u / (1 + u^4)^(1/4), full scale at u = 1.25.
struct Curve {
  int bits;
  bool shoulder;
  double top() const { return std::exp2(bits) - 1; }
  double full() const { return 1.25 / std::pow(1 + std::pow(1.25, 4), 0.25); }
  double value(double x) const {
    if (!(x > 0)) return 50 * x;
    const double u = 1.25 * std::pow(x, 1 / 2.2);
    return top() * (shoulder ? u / std::pow(1 + std::pow(u, 4), 0.25) / full() : u / 1.25);
  }
  double exposure(double v) const {
    const double w = v / top() * full();
    return std::pow(shoulder ? w / std::pow(1 - std::pow(w, 4), 0.25) / 1.25 : v / top(), 2.2);
  }
  /// ln of the exposure relative to that at mid-range.
  double log_in_gauge(double v) const { return std::log(exposure(v) / exposure(std::exp2(bits - 1))); }
};

ResponseEstimate simulate_and_estimate(const Curve& truth, unsigned seed) {
  SensorTruth s;
  s.bits = truth.bits, s.black = 0, s.gain = 30000, s.read_noise = 8;  // linear unit: full scale
  s.curve = [truth](double x) { return truth.value(x); };
  const auto radiance = test::log_uniform(6400, 2, 2000, seed);
  ResponseOptions options;
  options.recognise_linear = false;
  return estimate_response(std::vector<std::vector<RawFrame>>{test::simulate_bracket(s, 80, 80, radiance, test::time_series(0.0005, 1.7, 13), seed + 500)},
                           options);
}

struct Coverage {
  double one = 0, two = 0;  ///< share of the levels within 1 and 1.96 sigma
};

Coverage coverage(const Curve& truth) {
  const double range = std::exp2(truth.bits);
  Coverage sum;
  double n = 0;
  for (unsigned seed = 0; seed < 40; ++seed) {
    const ResponseCurve curve = simulate_and_estimate(truth, seed).response.curves[0];
    for (std::size_t i = 0; i < curve.band_value.size(); ++i) {
      const double v = curve.band_value[i];
      if (v < 0.08 * range || v > 0.95 * range || v == range / 2) continue;
      const double mid = curve.exposure[std::size_t{1} << (truth.bits - 1)];
      const double error = std::abs(std::log(curve.exposure[static_cast<std::size_t>(v)] / mid) - truth.log_in_gauge(v));
      sum.one += error < curve.band_log_sigma[i];
      sum.two += error < 1.96 * curve.band_log_sigma[i];
      ++n;
    }
  }
  return {sum.one / n, sum.two / n};
}

class Band : public testing::TestWithParam<int> {};

// Mean coverage over the levels from 8 to 95 % of the range, 40 seeds; nominal 68 and 95 %.
TEST_P(Band, HoldsTheTruthAsOftenAsItSays) {
  const Coverage film = coverage({GetParam(), true});
  EXPECT_GT(film.one, 0.60);
  EXPECT_LT(film.one, 0.75);
  EXPECT_GT(film.two, 0.90);
  EXPECT_LT(film.two, 0.98);
}

// The band allows for curves that bend as the prior says; a power law bends nowhere and is closer than that.
TEST_P(Band, IsOnTheSafeSideForAPowerLaw) {
  const Coverage power_law = coverage({GetParam(), false});
  EXPECT_GT(power_law.one, 0.60);
  EXPECT_GT(power_law.two, 0.90);
}

INSTANTIATE_TEST_SUITE_P(Response, Band, testing::Values(8, 12), [](const auto& info) { return std::to_string(info.param) + "bit"; });

TEST(ResponseBand, IsZeroAtMidRangeAndWideWhereNoPixelIs) {
  const ResponseCurve curve = simulate_and_estimate({10, true}, 1).response.curves[0];
  EXPECT_NEAR(*log_sigma_at(curve, 512), 0, 1e-9);
  EXPECT_LT(*log_sigma_at(curve, 700), 0.005);
  EXPECT_GT(*log_sigma_at(curve, 2), 20 * *log_sigma_at(curve, 700));
  EXPECT_FALSE(log_sigma_at(linear_response(10, 1, 0).curves[0], 512)) << "a line has none";
}

TEST(ResponseBand, ComesBackFromTheFileAndHostileOnesAreRefused) {
  const test::TemporaryFolder folder;
  const Response response = simulate_and_estimate({8, true}, 2).response;
  write_response(folder / "r.json", response);
  const Response back = read_response(folder / "r.json");
  EXPECT_EQ(back.curves[0].exposure, response.curves[0].exposure);
  EXPECT_EQ(back.curves[0].band_value, response.curves[0].band_value);
  EXPECT_EQ(back.curves[0].band_log_sigma, response.curves[0].band_log_sigma);

  std::ifstream in(folder / "r.json");
  const std::string text(std::istreambuf_iterator<char>(in), {});
  const auto error_of = [&](const std::string& field, const std::string& broken) -> std::string {
    const std::size_t start = text.find("\"" + field + "\":["), end = text.find(']', start);
    test::write_file(folder / "bad.json", text.substr(0, start) + "\"" + field + "\":" + broken + text.substr(end + 1));
    try {
      read_response(folder / "bad.json");
    } catch (const Error& e) {
      return e.what();
    }
    return "no error";
  };
  EXPECT_NE(error_of("value", "[3,2]").find("band.value: expected strictly increasing numbers"), std::string::npos);
  EXPECT_NE(error_of("value", "[3,1e9]").find("band.value: expected"), std::string::npos);
  EXPECT_NE(error_of("log_sigma", "[-1]").find("band.log_sigma: expected"), std::string::npos);
  EXPECT_NE(error_of("log_sigma", "\"x\"").find("band.log_sigma: expected"), std::string::npos);
}

}  // namespace
}  // namespace lacquer::calib
