#include <algorithm>
#include <vector>

#include "tests/test_support.h"

namespace lacquer {
namespace {

using test::run_lacquer;
using test::TemporaryFolder;

const std::string header = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg";

/// kd/pi = 1, 0.5, 0.25 and no lobes.
const std::string lambertian = R"({"kd": [3.141592653589793, 1.5707963267948966, 0.7853981633974483], "lobes": []})";

std::string quoted(const std::filesystem::path& file) { return "'" + file.string() + "'"; }

/// Runs eval on a paint and the text of a directions file.
test::CommandResult eval(const std::string& paint, const std::string& directions) {
  TemporaryFolder folder;
  test::write_file(folder / "paint.json", paint);
  test::write_file(folder / "d.csv", directions);
  return run_lacquer("eval " + quoted(folder / "paint.json") + " --directions " + quoted(folder / "d.csv"));
}

TEST(Eval, PrintsOneLineOfRgbPerDirection) {
  const auto result = eval(lambertian, header + "\n0,0,0,0\n30,10,60,-170.5\n");
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_EQ(result.out, "r,g,b\n1,0.5,0.25\n1,0.5,0.25\n");
  EXPECT_EQ(result.err, "");
}

TEST(Eval, PrintsTheValueOfAPaintOfTable1WithNineDigits) {
  TemporaryFolder folder;
  test::write_file(folder / "d.csv", header + "\n20,15,45,160\n");
  const auto result =
      run_lacquer("eval " + quoted(test::source_dir() / "data-samples/paints/bmw-339.json") + " --directions " + quoted(folder / "d.csv"));
  // tests/libbrdf/paints_reference.py: 0.237777206618, 0.276596003815, 0.284851055219
  EXPECT_EQ(result.out, "r,g,b\n0.237777207,0.276596004,0.284851055\n") << result.err;
}

TEST(Eval, ToleratesWindowsLineEndsByteOrderMarkSpacesPlusAndTrailingBlankLines) {
  const auto result = eval(lambertian, "\xef\xbb\xbf" + header + "\r\n 0, +1.5e1 ,2,3\r\n\r\n  \r\n");
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_EQ(result.out, "r,g,b\n1,0.5,0.25\n");
}

TEST(Eval, ReadsTheLastLineWithoutALineEndAndAFileWithoutRows) {
  EXPECT_EQ(eval(lambertian, header + "\n0,0,0,0").out, "r,g,b\n1,0.5,0.25\n");
  EXPECT_EQ(eval(lambertian, header).out, "r,g,b\n");
}

TEST(Eval, OnAndBelowTheHorizonTheValueIsZero) {
  EXPECT_EQ(eval(lambertian, header + "\n90,0,0,0\n0,0,90,0\n100,0,0,0\n89.999,0,0,0\n").out, "r,g,b\n0,0,0\n0,0,0\n0,0,0\n1,0.5,0.25\n");
}

TEST(Eval, ReadsDirectionsFromStdin) {
  TemporaryFolder folder;
  test::write_file(folder / "paint.json", lambertian);
  test::write_file(folder / "d.csv", header + "\n0,0,0,0\n");
  EXPECT_EQ(run_lacquer("eval " + quoted(folder / "paint.json") + " --directions - <" + quoted(folder / "d.csv")).out, "r,g,b\n1,0.5,0.25\n");
}

TEST(Eval, LeavesFieldsEmptyWhereTheTableHasAHoleAndCountsThem) {
  TemporaryFolder folder;
  std::string merl;
  for (const std::int32_t n : {90, 90, 180}) merl.append(reinterpret_cast<const char*>(&n), 4);
  // The cells theta_h 3 (0.10 to 0.18 deg), theta_d 30, any phi_d, hold 1500 in every plane; all others are -1.
  std::vector<double> values(3 * 1458000, -1.0);
  for (std::size_t plane = 0; plane < 3; ++plane) std::fill_n(&values[plane * 1458000 + 180 * (30 + 90 * 3)], 180, 1500.0);
  merl.append(reinterpret_cast<const char*>(values.data()), 8 * values.size());
  test::write_file(folder / "m.binary", merl);
  // 30.62 and 30.38 deg on opposite sides: theta_h = 0.12, theta_d = 30.5
  test::write_file(folder / "d.csv", header + "\n10,0,20,30\n30.62,0,30.38,180\n40,0,40,90\n");
  const std::string command = "eval " + quoted(folder / "m.binary") + " --directions " + quoted(folder / "d.csv");
  const auto result = run_lacquer(command);
  EXPECT_EQ(result.exit_code, 0) << result.err;
  EXPECT_EQ(result.out.substr(0, 11), "r,g,b\n,,\n1,") << result.out;
  EXPECT_EQ(result.out.substr(result.out.size() - 4), "\n,,\n");
  EXPECT_EQ(result.err.substr(0, 17), "2 of 3 directions") << result.err;
  EXPECT_EQ(run_lacquer("--quiet " + command).err, "");
}

TEST(Eval, NamesFileAndLineOfABadRow) {
  const auto expect_error = [](const std::string& directions, const std::string& part) {
    const auto result = eval(lambertian, directions);
    EXPECT_EQ(result.exit_code, 1);
    EXPECT_EQ(result.out, "");
    EXPECT_NE(result.err.find(part), std::string::npos) << result.err;
    EXPECT_EQ(result.err.find('\n'), result.err.size() - 1) << result.err;  // one line
  };
  expect_error(header + "\n0,0,0,0\n0,0,x,0\n", "d.csv:3: theta_o_deg: expected a number, got 'x'");
  expect_error(header + "\n0,0,0\n", "d.csv:2: expected 4 numbers");
  expect_error(header + "\n0,0,0,0,0\n", "d.csv:2: expected 4 numbers");
  expect_error(header + "\n0,,0,0\n", "d.csv:2: phi_i_deg: expected a number, got ''");
  expect_error(header + "\n0,nan,0,0\n", "d.csv:2: phi_i_deg: expected a number, got 'nan'");
  expect_error(header + "\n0,0,inf,0\n", "d.csv:2: theta_o_deg: expected a number");
  expect_error(header + "\n-1,0,0,0\n", "d.csv:2: theta_i_deg: expected 0 to 180 degrees, got -1");
  expect_error(header + "\n0,0,0,0\n\n0,0,0,0\n", "d.csv:3: expected 4 numbers, got an empty line");
  expect_error("0,0,0,0\n", "d.csv:1: expected the header " + header);
  expect_error("", "is empty");
}

TEST(Eval, MissingFilesAreOneLineAndExitCode1AndMissingOptionsExitCode2) {
  const auto result = run_lacquer("eval /nonexistent.json --directions -");
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_NE(result.err.find("/nonexistent.json: cannot be opened"), std::string::npos) << result.err;
  EXPECT_EQ(run_lacquer("eval paint.json").exit_code, 2);
  EXPECT_EQ(run_lacquer("eval").exit_code, 2);
}

}  // namespace
}  // namespace lacquer
