#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include <cmath>
#include <glm/geometric.hpp>
#include <random>

#include "libcalib/geometry_residuals.h"
#include "libcalib/geometry_unknowns.h"
#include "libcalib/quick_rig.h"

/// The geometry's solver beside Ceres, which gets the same residuals and nothing else: derivatives by its own differences, its own steps.
namespace lacquer::calib {
namespace {

constexpr double degree = 3.14159265358979323846 / 180;

struct Residuals {
  const GeometryResiduals* residuals;
  bool operator()(double const* const* parameters, double* out) const {
    const std::size_t n = residuals->unknowns().size();
    const std::vector<double> r = residuals->at(std::vector<double>(parameters[0], parameters[0] + n));
    std::copy(r.begin(), r.end(), out);
    return true;
  }
};

TEST(GeometrySolver, CeresFindsTheSameMinimum) {
  const acquire::RigGeometry nominal = test::quick_rig(2);
  std::mt19937_64 random(11);
  std::normal_distribution<double> normal;
  const auto draw = [&](double sigma) { return sigma * normal(random); };
  acquire::RigGeometry truth = nominal;
  truth.cam_from_rig.translation += glm::dvec3(0.002, -0.003, 0.002);
  truth.axis_direction = glm::normalize(glm::dvec3(0.015, 1, -0.01));
  truth.axis_point = {0.002, 0, -0.003};
  for (acquire::Light& light : truth.lights) light.position += glm::dvec3(draw(0.005), draw(0.005), draw(0.01));

  std::vector<EdgePoint> edges;
  const glm::dvec2 centre = *truth.camera.project(truth.cam_from_rig.translation);
  for (int k = 0; k < 90; ++k) {
    const glm::dvec2 out(std::cos(4 * degree * k), std::sin(4 * degree * k));
    double radius = 153;
    for (int i = 0; i < 20; ++i) radius -= *silhouette_distance(truth, centre + radius * out);
    edges.push_back({centre + (radius + draw(0.05)) * out, 0.05});
  }
  std::vector<Highlight> highlights;
  for (std::size_t light = 0; light < 2; ++light)
    for (int a = 0; a <= 130; a += 5) {
      const auto pixel = mirror_pixel(truth, truth.place_light(light, a * degree + draw(0.005 * degree)).position);
      if (pixel) highlights.push_back({"L", light, a * degree, *pixel + glm::dvec2(draw(0.01), draw(0.01)), 1e-4, 0, 1e-4});
    }
  GeometryEvidence evidence;  // one more line of it: the first light's x and the axis' place together
  const GeometryUnknowns unknowns(nominal, {}, {true, true});
  evidence.rows.assign(1, std::vector<double>(unknowns.size()));
  evidence.rows[0][6] = 300;
  evidence.rows[0][12] = -200;
  const double tilt = std::atan2(truth.axis_direction.z, truth.axis_direction.y), x = truth.lights[0].position.x - nominal.lights[0].position.x;
  evidence.offset = {300 * tilt / unknowns.parameters()[6].prior_sigma - 200 * x / unknowns.parameters()[12].prior_sigma + 2};

  const GeometryEstimate ours = solve_geometry(nominal, edges, highlights, {}, evidence);
  ASSERT_TRUE(ours.converged);
  ASSERT_EQ(ours.n_highlights, highlights.size()) << "an outlier would make it another problem";
  std::vector<double> found;
  for (const GeometryParameter& p : ours.uncertainty.parameters) found.push_back(p.correction / p.prior_sigma);

  GeometryResiduals residuals(unknowns, edges, highlights, evidence);
  residuals.measure_noise(found);
  residuals.select_inliers(found);
  // Noise was measured once more here, where the solver had stopped doing so: its own last step begins at the same point.
  std::vector<double> theirs(unknowns.size());
  auto* function = new ceres::DynamicNumericDiffCostFunction<Residuals>(new Residuals{&residuals});
  function->AddParameterBlock(static_cast<int>(theirs.size()));
  function->SetNumResiduals(static_cast<int>(residuals.at(theirs).size()));
  ceres::Problem problem;
  problem.AddResidualBlock(function, nullptr, theirs.data());
  ceres::Solver::Options options;
  options.max_num_iterations = 500;
  options.function_tolerance = 1e-15;
  options.parameter_tolerance = 1e-14;
  options.gradient_tolerance = 1e-14;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  ASSERT_TRUE(summary.IsSolutionUsable()) << summary.BriefReport();

  for (std::size_t k = 0; k < found.size(); ++k) {
    const GeometryParameter& p = ours.uncertainty.parameters[k];
    EXPECT_NEAR(theirs[k] * p.prior_sigma, p.correction, 0.05 * p.sigma) << p.name;
  }
  std::vector<double> weight;
  const double own_cost = residuals.cost(residuals.at(found), 0, weight);
  EXPECT_LT(own_cost, 2 * summary.final_cost * (1 + 1e-4));
}

}  // namespace
}  // namespace lacquer::calib
