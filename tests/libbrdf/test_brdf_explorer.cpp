#include "libbrdf/brdf_explorer.h"

#include <sstream>

#include "libbrdf/files.h"
#include "tests/libbrdf/file_test_support.h"
#include "tests/libbrdf/table1_paints.h"

namespace lacquer::brdf {
namespace {

/// GLSL as C++: the shader's own text with a vec3 of doubles, and a main that reads directions and prints values.
std::string program_of(const std::string& text) {
  const auto between = [&](const std::string& begin, const std::string& end) {
    const auto at = text.find(begin) + begin.size();
    return text.substr(at, text.find(end) - at);
  };
  std::string program = R"(
#include <cmath>
#include <cstdio>
#define float double
struct vec3 { double x, y, z; vec3(double a, double b, double c) : x(a), y(b), z(c) {} explicit vec3(double a) : x(a), y(a), z(a) {} };
vec3 operator+(vec3 a, vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
vec3 operator*(vec3 a, double s) { return {a.x * s, a.y * s, a.z * s}; }
vec3 operator/(vec3 a, double s) { return a * (1 / s); }
void operator+=(vec3& a, vec3 b) { a = a + b; }
double dot(vec3 a, vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
vec3 normalize(vec3 a) { return a / std::sqrt(dot(a, a)); }
double min(double a, double b) { return a < b ? a : b; }
using std::exp; using std::pow;
)";
  std::istringstream lines(between("::begin parameters\n", "::end parameters"));
  std::string type, name, a, b, c;
  while (lines >> type >> name >> a >> b >> c)
    program += type == "color" ? "vec3 " + name + "(" + a + "," + b + "," + c + ");\n" : "double " + name + " = " + c + ";\n";
  return program + between("::begin shader\n", "::end shader") + R"(
int main() {
  double a[6];
  while (std::scanf("%lf %lf %lf %lf %lf %lf", a, a + 1, a + 2, a + 3, a + 4, a + 5) == 6) {
    vec3 f = BRDF(vec3(a[0], a[1], a[2]), vec3(a[3], a[4], a[5]), vec3(0, 0, 1), vec3(1, 0, 0), vec3(0, 1, 0));
    std::printf("%.12g %.12g %.12g\n", f.x, f.y, f.z);
  }
})";
}

TEST(BrdfExplorer, TheShaderItselfGivesTheModelsValues) {
  test::TemporaryFolder folder;
  const CookTorrance model = test::table1_paint("polaris-silber");
  test::write_file(folder / "s.cpp", program_of(brdf_explorer_text(model, "test")));
  std::ostringstream in;
  in.precision(17);
  std::vector<Directions> directions;
  for (const double theta_i : {0.0, 0.3, 0.9, 1.4})
    for (const double theta_o : {0.01, 0.31, 0.9, 1.5})
      for (const double phi : {0.0, 2.0, 3.14}) {
        const Directions d{direction(theta_i, 0.2), direction(theta_o, 0.2 + phi)};
        directions.push_back(d);
        in << d.wi.x << ' ' << d.wi.y << ' ' << d.wi.z << ' ' << d.wo.x << ' ' << d.wo.y << ' ' << d.wo.z << '\n';
      }
  test::write_file(folder / "in", in.str());
  const std::string at = folder.path().string();
  if (std::system("c++ --version >/dev/null 2>&1") != 0) GTEST_SKIP() << "SKIPPED LOUDLY: no compiler c++ to run the shader with";
  ASSERT_EQ(std::system(("c++ -o " + at + "/s " + at + "/s.cpp && " + at + "/s < " + at + "/in > " + at + "/out").c_str()), 0);
  std::istringstream out(test::slurp(folder / "out"));
  const CookTorranceBrdf brdf(model);
  for (const auto& d : directions)
    for (int c = 0; c < 3; ++c) {
      double value = 0;
      ASSERT_TRUE(out >> value);
      EXPECT_NEAR(value / (*brdf.value(d))[c], 1, 1e-9);
    }
}

TEST(BrdfExplorer, ParametersReadBackExactly) {
  for (const auto& paint : test::table1_paints())
    EXPECT_EQ(model_to_json(brdf_explorer_model(brdf_explorer_text(paint.model, "x\n::end parameters"), "x")), model_to_json(paint.model)) << paint.name;
  test::expect_file_error([] { brdf_explorer_model("analytic\n", "x.brdf"); }, {"x.brdf", "color kd"});
  test::expect_file_error([] { brdf_explorer_model("::begin parameters\ncolor kd 1 2 x\n", "x.brdf"); }, {"x.brdf"});
}

}  // namespace
}  // namespace lacquer::brdf
