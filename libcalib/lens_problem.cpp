#include "libcalib/lens_problem.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

extern "C" {
#include <mrcal/mrcal.h>
}
#include <suitesparse/cholmod.h>

#include "libbrdf/error.h"

namespace lacquer::calib {

namespace {

mrcal_lensmodel_t lens_model_of(const std::string& name) {
  mrcal_lensmodel_t model;
  if (!mrcal_lensmodel_from_name(&model, name.c_str()))
    throw Error(ErrorCode::usage, fmt::format("lens model {}: not one of mrcal's; expected e.g. LENSMODEL_OPENCV8", name));
  return model;
}

/// The arguments that mrcal's optimiser and its callback share. One camera that is the reference, a frame per board.
struct Arguments {
  explicit Arguments(const LensProblem& p, const LensFreedom& f) : model(lens_model_of(p.model)), image_size{p.width, p.height} {
    for (const BoardPose& pose : p.poses) {
      mrcal_pose_t rt;
      std::copy(pose.begin(), pose.begin() + 3, rt.r.xyz);
      std::copy(pose.begin() + 3, pose.end(), rt.t.xyz);
      poses.push_back(rt);
      observations.push_back({.icam = {.intrinsics = 0, .extrinsics = -1}, .iframe = static_cast<int>(observations.size())});
    }
    for (const glm::dvec3& o : p.observed) {
      mrcal_point3_t point;
      point.x = o.x, point.y = o.y, point.z = o.z;
      observed.push_back(point);
    }
    warp.x2 = p.warp[0], warp.y2 = p.warp[1];
    selections.do_optimize_intrinsics_core = f.core;
    selections.do_optimize_intrinsics_distortions = f.distortion && mrcal_lensmodel_num_params(&model) > 4;
    selections.do_optimize_extrinsics = true;  // there are none
    selections.do_optimize_frames = f.poses;
    selections.do_optimize_calobject_warp = f.warp;
    selections.do_apply_regularization = f.regularise;
    selections.do_apply_outlier_rejection = false;  // it prints
  }
  int n_boards() const { return static_cast<int>(poses.size()); }

  mrcal_lensmodel_t model;
  int image_size[2];
  std::vector<mrcal_pose_t> poses;
  std::vector<mrcal_observation_board_t> observations;
  std::vector<mrcal_point3_t> observed;
  mrcal_calobject_warp_t warp{};
  mrcal_problem_selections_t selections{};
  mrcal_problem_constants_t constants{.point_min_range = 0.01, .point_max_range = 1000};  // of points, which we have none of
  int n_states() const { return mrcal_num_states(1, 0, n_boards(), 0, 0, n_boards(), selections, &model); }
  int n_measurements(const BoardShape& b) const {
    return mrcal_num_measurements(n_boards(), 0, b.columns, b.rows, 1, 0, n_boards(), 0, 0, selections, &model);
  }
};

/// Residuals of mrcal are weight * (predicted - observed); here all weights are 1.
std::vector<glm::dvec2> corner_residuals(const std::vector<double>& x, std::size_t n_corners) {
  std::vector<glm::dvec2> residuals;
  for (std::size_t i = 0; i < n_corners; ++i) residuals.emplace_back(x[2 * i], x[2 * i + 1]);
  return residuals;
}

/// J'J of the columns [begin, end) of the transposed Jacobian, one per measurement.
SymmetricMatrix normal_matrix(std::size_t n, const std::vector<int>& start, const std::vector<int>& index, const std::vector<double>& value, std::size_t begin,
                              std::size_t end) {
  SymmetricMatrix a(n);
  for (std::size_t m = begin; m < end; ++m)
    for (int i = start[m]; i < start[m + 1]; ++i)
      for (int j = start[m]; j <= i; ++j) {
        const auto row = static_cast<std::size_t>(index[i]), column = static_cast<std::size_t>(index[j]);
        a.at(std::max(row, column), std::min(row, column)) += value[i] * value[j];
      }
  return a;
}

mrcal_point3_t point_of(const glm::dvec3& p) {
  mrcal_point3_t q;
  q.x = p.x, q.y = p.y, q.z = p.z;
  return q;
}

}  // namespace

std::size_t n_intrinsics_of(const std::string& model) {
  mrcal_lensmodel_t m;
  return mrcal_lensmodel_from_name(&m, model.c_str()) ? static_cast<std::size_t>(mrcal_lensmodel_num_params(&m)) : 0;
}

LensSolution solve_lens(LensProblem& p, const LensFreedom& freedom) {
  Arguments a(p, freedom);
  std::vector<double> state(static_cast<std::size_t>(a.n_states())), x(static_cast<std::size_t>(a.n_measurements(p.board)));
  const mrcal_stats_t stats =
      mrcal_optimize(state.data(), static_cast<int>(state.size() * sizeof(double)), x.data(), static_cast<int>(x.size() * sizeof(double)), p.intrinsics.data(),
                     nullptr, a.poses.data(), nullptr, &a.warp, 1, 0, a.n_boards(), 0, 0, a.observations.data(), nullptr, a.n_boards(), 0, a.observed.data(),
                     &a.model, a.image_size, a.selections, &a.constants, p.board.square_m, p.board.columns, p.board.rows, false, false);
  if (!(stats.rms_reproj_error__pixels >= 0) || !std::isfinite(stats.rms_reproj_error__pixels))
    throw Error(ErrorCode::input, fmt::format("{}: mrcal found no solution for these boards; are board size and square right?", p.model));
  for (std::size_t i = 0; i < p.poses.size(); ++i) {
    std::copy(a.poses[i].r.xyz, a.poses[i].r.xyz + 3, p.poses[i].begin());
    std::copy(a.poses[i].t.xyz, a.poses[i].t.xyz + 3, p.poses[i].begin() + 3);
  }
  p.warp = {a.warp.x2, a.warp.y2};
  std::size_t n_outliers = 0;
  for (std::size_t i = 0; i < p.observed.size(); ++i) {
    p.observed[i].z = a.observed[i].z;
    n_outliers += p.observed[i].z < 0;
  }
  LensSolution solution{0, n_outliers, corner_residuals(x, p.observed.size())};
  double sum = 0;
  for (const glm::dvec2& r : solution.residuals) sum += r.x * r.x + r.y * r.y;
  solution.rms_px = std::sqrt(sum / static_cast<double>(std::max<std::size_t>(p.observed.size() - n_outliers, 1)));
  return solution;
}

LensInformation lens_information(const LensProblem& p, const LensFreedom& freedom) {
  Arguments a(p, freedom);
  const auto n_states = static_cast<std::size_t>(a.n_states()), n_measurements = static_cast<std::size_t>(a.n_measurements(p.board));
  const auto n_nonzero = static_cast<std::size_t>(_mrcal_num_j_nonzero(a.n_boards(), 0, p.board.columns, p.board.rows, 1, 0, a.n_boards(), 0, 0,
                                                                       a.observations.data(), nullptr, a.selections, &a.model));
  std::vector<int> start(n_measurements + 1), index(n_nonzero);
  std::vector<double> value(n_nonzero), state(n_states), x(n_measurements);
  cholmod_sparse jt{};
  jt.nrow = n_states, jt.ncol = n_measurements, jt.nzmax = n_nonzero;
  jt.p = start.data(), jt.i = index.data(), jt.x = value.data();
  jt.itype = CHOLMOD_INT, jt.xtype = CHOLMOD_REAL, jt.dtype = CHOLMOD_DOUBLE;
  jt.sorted = 1, jt.packed = 1;
  if (!mrcal_optimizer_callback(state.data(), static_cast<int>(n_states * sizeof(double)), x.data(), static_cast<int>(n_measurements * sizeof(double)), &jt,
                                p.intrinsics.data(), nullptr, a.poses.data(), nullptr, &a.warp, 1, 0, a.n_boards(), 0, 0, a.observations.data(), nullptr,
                                a.n_boards(), 0, a.observed.data(), &a.model, a.image_size, a.selections, &a.constants, p.board.square_m, p.board.columns,
                                p.board.rows, false))
    throw Error(ErrorCode::input, fmt::format("{}: mrcal could not evaluate the solution", p.model));

  LensInformation information;
  information.scale.assign(n_states, 1.0);
  mrcal_unpack_solver_state_vector(information.scale.data(), 1, 0, a.n_boards(), 0, 0, a.selections, &a.model);
  const std::size_t n_corner_rows = static_cast<std::size_t>(mrcal_num_measurements_boards(a.n_boards(), p.board.columns, p.board.rows));
  information.corners = normal_matrix(n_states, start, index, value, 0, n_corner_rows);
  information.all = normal_matrix(n_states, start, index, value, n_corner_rows, n_measurements);
  information.all.add(information.corners);
  information.n_intrinsics = static_cast<std::size_t>(mrcal_num_states_intrinsics(1, a.selections, &a.model));
  information.first_intrinsic = freedom.core ? 0 : 4;
  information.first_pose = information.n_intrinsics;
  return information;
}

std::vector<glm::dvec2> project(const std::string& model, const std::vector<double>& intrinsics, const std::vector<glm::dvec3>& p_cam) {
  const mrcal_lensmodel_t m = lens_model_of(model);
  std::vector<mrcal_point3_t> points;
  for (const glm::dvec3& p : p_cam) points.push_back(point_of(p));
  std::vector<mrcal_point2_t> pixels(points.size());
  mrcal_project(pixels.data(), nullptr, nullptr, points.data(), static_cast<int>(points.size()), &m, intrinsics.data());
  std::vector<glm::dvec2> result;
  for (const mrcal_point2_t& q : pixels) result.emplace_back(q.x, q.y);
  return result;
}

std::vector<glm::dvec3> unproject(const std::string& model, const std::vector<double>& intrinsics, const std::vector<glm::dvec2>& pixels) {
  const mrcal_lensmodel_t m = lens_model_of(model);
  std::vector<glm::dvec3> result;
  for (const glm::dvec2& pixel : pixels) {
    mrcal_point2_t q;
    q.x = pixel.x, q.y = pixel.y;
    mrcal_point3_t v;
    const bool found = mrcal_unproject(&v, &q, 1, &m, intrinsics.data());
    const double length = std::sqrt(v.x * v.x + v.y * v.y + v.z * v.z);
    result.push_back(found ? glm::dvec3(v.x, v.y, v.z) / length : glm::dvec3(std::numeric_limits<double>::quiet_NaN()));
  }
  return result;
}

std::array<std::vector<double>, 2> pixel_gradient(const LensProblem& p, const LensInformation& information, const glm::dvec3& p_cam, bool at_infinity) {
  const mrcal_lensmodel_t m = lens_model_of(p.model);
  const auto n_all = p.intrinsics.size();
  std::vector<double> by_intrinsics(2 * n_all);
  mrcal_point3_t by_point[2];
  mrcal_point2_t q;
  const mrcal_point3_t point = point_of(p_cam);
  mrcal_project(&q, by_point, by_intrinsics.data(), &point, 1, &m, p.intrinsics.data());
  std::array<std::vector<double>, 2> gradient;
  for (std::size_t k = 0; k < 2; ++k) {
    gradient[k].assign(information.scale.size(), 0.0);
    for (std::size_t i = 0; i < information.n_intrinsics; ++i) gradient[k][i] = by_intrinsics[k * n_all + information.first_intrinsic + i];
  }
  const double share = 1 / static_cast<double>(p.poses.size());
  for (std::size_t b = 0; b < p.poses.size(); ++b) {
    BoardPose pose = p.poses[b];
    if (at_infinity) std::fill(pose.begin() + 3, pose.end(), 0.0);
    double on_board[3], again[3], by_pose[18];
    mrcal_transform_point_rt_inverted(on_board, nullptr, nullptr, pose.data(), point.xyz);
    mrcal_transform_point_rt(again, by_pose, nullptr, pose.data(), on_board);
    for (std::size_t k = 0; k < 2; ++k)
      for (std::size_t i = 0; i < (at_infinity ? 3u : 6u); ++i) {
        double sum = 0;
        for (std::size_t axis = 0; axis < 3; ++axis) sum += by_point[k].xyz[axis] * by_pose[axis * 6 + i];
        gradient[k][information.first_pose + 6 * b + i] = share * sum;
      }
  }
  for (auto& row : gradient)
    for (std::size_t i = 0; i < row.size(); ++i) row[i] *= information.scale[i];
  return gradient;
}

}  // namespace lacquer::calib
