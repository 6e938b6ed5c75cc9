#include "libfit/sample_fit.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <numbers>
#include <numeric>

#include "libbrdf/cook_torrance.h"
#include "libbrdf/error.h"
#include "libbrdf/table.h"
#include "libfit/comparison.h"
#include "libfit/kernels.h"
#include "libfit/objective.h"
#include "libfit/solver.h"
#include "libfit/uncertainty.h"

namespace lacquer::fit {

namespace {

using brdf::TableGrid;

constexpr std::size_t n_groups = std::size_t{TableGrid::n_theta_h} * TableGrid::n_theta_d;
/// Views whose sums are kept until they are added in order; so many images may be in memory, one per thread at a time.
constexpr std::size_t views_together = 16;

Structure structure_of(const FitResult& fit) {
  Structure structure{.n_lobes = static_cast<int>(fit.model.lobes.size()), .diffuse = false};
  for (const Parameter& p : fit.parameters) {
    structure.diffuse |= p.name.starts_with("kd");
    if (p.name.starts_with("ks") && p.name.find('.') == std::string::npos) structure.grey[std::stoul(p.name.substr(2)) - 1] = true;
  }
  for (std::size_t l = 0; l < fit.model.lobes.size(); ++l) {
    structure.distribution[l] = fit.model.lobes[l].distribution;
    structure.fresnel[l] = fit.model.lobes[l].fresnel;
  }
  return structure;
}

/// A sample as the loops need it, all of one channel.
struct Prepared {
  std::uint32_t cell;  ///< of the table's grid
  float tan2_theta_h, schlick_weight, front, along, across, mixed;
  double value, variance;
  bool clipped;
};

/// False: it cannot be used.
bool prepare(const SampleValue& s, double min_cosine, Prepared& to) {
  const auto& v = s.footprint;
  if (!std::isfinite(s.value) || !std::isfinite(s.variance) || s.variance < 0 || (s.value <= 0 && (s.variance == 0 || s.clipped))) return false;
  if (!(v.along >= 0 && v.across >= 0 && v.mixed * v.mixed <= v.along * v.across * (1 + 1e-5))) return false;
  const brdf::HalfDiff& c = s.coordinates;
  if (!(c.theta_h >= 0 && c.theta_h < std::numbers::pi / 2 && c.theta_d >= 0 && c.theta_d <= std::numbers::pi / 2 && std::isfinite(c.phi_d))) return false;
  const auto cosines = brdf::half_angle_cosines(c);
  if (!(std::min(cosines.n_dot_i, cosines.n_dot_o) > min_cosine)) return false;
  const double nh2 = cosines.n_dot_h * cosines.n_dot_h;
  to = {.cell = static_cast<std::uint32_t>(TableGrid::index(c)),
        .tan2_theta_h = static_cast<float>(cosines.tan2_theta_h),
        .schlick_weight = static_cast<float>(brdf::schlick_weight(cosines.i_dot_h)),
        .front = static_cast<float>(brdf::geometry_over_cosines(cosines) * std::numbers::inv_pi / (nh2 * nh2)),
        .along = static_cast<float>(v.along),
        .across = static_cast<float>(v.across),
        .mixed = static_cast<float>(v.mixed),
        .value = s.value,
        .variance = s.variance,
        .clipped = s.clipped};
  return true;
}

/// What is the same in every pass.
struct Problem {
  const FitResult& table_fit;
  ParameterLayout layout;
  double energy_weight;
  std::vector<float> group_factor{};  ///< on 1 / sigma by channel and (theta_h, theta_d); empty: 1, see limit_groups
};

void fill_geometry(const std::vector<Prepared>& samples, CellSet& set) {
  const std::size_t n = samples.size();
  set.cell.resize(n);
  for (auto* column : {&set.tan2_theta_h, &set.schlick_weight, &set.front, &set.along, &set.across, &set.mixed}) column->resize(n);
  for (std::size_t k = 0; k < n; ++k) {
    const Prepared& s = samples[k];
    set.cell[k] = s.cell;
    set.tan2_theta_h[k] = s.tan2_theta_h, set.schlick_weight[k] = s.schlick_weight, set.front[k] = s.front;
    set.along[k] = s.along, set.across[k] = s.across, set.mixed[k] = s.mixed;
  }
}

/// The stated variance of a sample comes from its own noisy value: weights made of it would favour what is too dark, and a parameter is
/// known to much less than one sample's noise. So each takes its neighbour's, scaled by the model. `samples` in the order of the pixels.
void take_neighbours_noise(const std::vector<double>& expected, std::vector<Prepared>& samples) {
  double previous = samples.size() > 1 && expected[1] > 0 ? samples[1].variance / expected[1] : 0;
  for (std::size_t k = 0; k < samples.size(); ++k) {
    if (!(expected[k] > 0)) continue;
    const double own = samples[k].variance / expected[k];
    if (previous > 0) samples[k].variance = previous * expected[k];
    previous = own;
  }
}

/// Samples next to each other in a CellSet that share a key.
struct Run {
  std::size_t begin, end;
  int key;
};

/// Samples of one channel of a piece of a view, weighed by the table's model.
class SampleSet {
 public:
  SampleSet(int channel, std::vector<Prepared>& samples, const Problem& problem) : samples_(samples), problem_(problem) {
    set_.first_channel = channel, set_.n_channels = 1;
    fill_geometry(samples_, set_);
    evaluate(set_, 0, samples_.size(), problem_.table_fit.model, expected_);
    take_neighbours_noise(expected_[0], samples_);
    weigh();
  }
  const CellSet& cells() const { return set_; }
  const std::vector<Prepared>& samples() const { return samples_; }

  /// Puts them into the order of `key`.
  std::vector<Run> sort_by(int (*key)(const TableGrid::Cell&)) {
    const auto key_of = [&](const Prepared& s) { return key(TableGrid::cell(std::size_t{s.cell})); };
    std::stable_sort(samples_.begin(), samples_.end(), [&](const Prepared& a, const Prepared& b) { return key_of(a) < key_of(b); });
    fill_geometry(samples_, set_);
    evaluate(set_, 0, samples_.size(), problem_.table_fit.model, expected_);
    weigh();
    std::vector<Run> runs;
    for (std::size_t k = 0; k < samples_.size(); ++k) {
      const int of = key_of(samples_[k]);
      if (runs.empty() || runs.back().key != of) runs.push_back({k, k, of});
      runs.back().end = k + 1;
    }
    return runs;
  }

 private:
  void weigh() {
    const double model_sigma = problem_.table_fit.options.model_sigma;
    auto& [target, inverse_sigma] = set_.channels[0];
    target.resize(samples_.size()), inverse_sigma.resize(samples_.size());
    for (std::size_t k = 0; k < samples_.size(); ++k) {
      const Prepared& s = samples_[k];
      const Comparison c = s.clipped ? comparison_with_bound(s.value, s.variance, model_sigma) : comparison(s.value, s.variance, expected_[0][k], model_sigma);
      const auto group = static_cast<std::size_t>(set_.first_channel) * n_groups + s.cell / TableGrid::n_phi_d;
      target[k] = c.target;
      inverse_sigma[k] = c.inverse_sigma * (problem_.group_factor.empty() ? 1.0f : problem_.group_factor[group]);
    }
  }

  CellSet set_;
  std::vector<Prepared>& samples_;
  const Problem& problem_;
  std::array<std::vector<double>, 3> expected_;
};

/// work(SampleSet) for the samples of each channel of a view, piece by piece.
template <typename Work>
void for_each_set(const SampleSource& source, std::size_t view, const Problem& problem, const Work& work) {
  std::array<std::vector<Prepared>, 3> by_channel;
  source.view(view, [&](std::span<const SampleValue> piece) {
    for (auto& samples : by_channel) samples.clear();
    Prepared prepared;
    for (const SampleValue& s : piece)
      if (prepare(s, problem.table_fit.options.min_cosine, prepared)) by_channel[static_cast<std::size_t>(s.channel)].push_back(prepared);
    for (int c = 0; c < source.n_channels; ++c) {
      auto& samples = by_channel[static_cast<std::size_t>(c)];
      if (samples.empty()) continue;
      SampleSet set(c, samples, problem);
      work(set);
    }
  });
}

/// Sum of work(view) over all views, always in the same order.
template <typename Sum, typename Work>
void sum_over_views(std::size_t n_views, Sum& total, const Work& work) {
  for (std::size_t first = 0; first < n_views; first += views_together) {
    std::vector<Sum> sums(std::min(views_together, n_views - first));
    tbb::parallel_for(std::size_t{0}, sums.size(), [&](std::size_t i) { work(first + i, sums[i]); }, tbb::simple_partitioner());
    for (const Sum& sum : sums) total += sum;
  }
}

int theta_h_row(const TableGrid::Cell& c) { return c.theta_h; }
int theta_d_column(const TableGrid::Cell& c) { return c.theta_d; }

void add_all(const Sums& from, Sums& to) {
  for (std::size_t c = 0; c < 3; ++c) add(from[c], max_local, to[c]);
}

struct SampleSums {
  Sums sums{};
  SampleSums& operator+=(const SampleSums& other) {
    add_all(other.sums, sums);
    return *this;
  }
};

Sums pass(const SampleSource& source, const Problem& problem, const brdf::CookTorrance& model, Curvature kind) {
  SampleSums total;
  sum_over_views(source.n_views, total, [&](std::size_t view, SampleSums& sum) {
    for_each_set(source, view, problem, [&](const SampleSet& set) {
      add_quadratic(set.cells(), 0, set.cells().size(), model, problem.table_fit.options.robust_scale, kind, sum.sums);
    });
  });
  return total.sums;
}

/// Counts, and what groups of samples weigh.
struct Overview {
  std::size_t n_values = 0, n_bounds = 0;
  std::vector<double> weight = std::vector<double>(3 * n_groups);
  Overview& operator+=(const Overview& other) {
    n_values += other.n_values;
    n_bounds += other.n_bounds;
    for (std::size_t i = 0; i < weight.size(); ++i) weight[i] += other.weight[i];
    return *this;
  }
};

Overview overview(const SampleSource& source, const Problem& problem) {
  Overview total;
  sum_over_views(source.n_views, total, [&](std::size_t view, Overview& sum) {
    for_each_set(source, view, problem, [&](const SampleSet& set) {
      const auto& [target, inverse_sigma] = set.cells().channels[0];
      for (std::size_t k = 0; k < set.samples().size(); ++k) {
        const Prepared& s = set.samples()[k];
        ++(s.clipped ? sum.n_bounds : sum.n_values);
        const double relative = inverse_sigma[k] >= 0 ? inverse_sigma[k] : -inverse_sigma[k] * std::max(0.0f, target[k]);
        sum.weight[static_cast<std::size_t>(set.cells().first_channel) * n_groups + s.cell / TableGrid::n_phi_d] += relative * relative;
      }
    });
  });
  return total;
}

/// What the errors are made of, at the solution.
struct Groups {
  std::vector<Sums> rows = std::vector<Sums>(TableGrid::n_theta_h), columns = std::vector<Sums>(TableGrid::n_theta_d), views{};
  double sum_log = 0, squares_log = 0;
  std::size_t n_log = 0;
  Groups& operator+=(const Groups& other) {
    for (std::size_t i = 0; i < rows.size(); ++i) add_all(other.rows[i], rows[i]);
    for (std::size_t i = 0; i < columns.size(); ++i) add_all(other.columns[i], columns[i]);
    views.insert(views.end(), other.views.begin(), other.views.end());
    sum_log += other.sum_log;
    squares_log += other.squares_log;
    n_log += other.n_log;
    return *this;
  }
};

void add_log_errors(const SampleSet& set, const brdf::CookTorrance& model, Groups& groups) {
  const std::vector<Prepared>& samples = set.samples();
  std::array<std::vector<double>, 3> values;
  evaluate(set.cells(), 0, samples.size(), model, values);
  for (std::size_t k = 0; k < samples.size(); ++k) {
    if (samples[k].clipped || !(samples[k].value > 0) || !(values[0][k] > 0)) continue;
    const double difference = std::log(values[0][k] / samples[k].value);
    groups.sum_log += std::abs(difference);
    groups.squares_log += difference * difference;
    ++groups.n_log;
  }
}

GroupedQuadratics grouped(const SampleSource& source, const Problem& problem, const brdf::CookTorrance& model, std::size_t n_values, FitResult& result) {
  Groups groups;
  const double robust_scale = problem.table_fit.options.robust_scale;
  sum_over_views(source.n_views, groups, [&](std::size_t view, Groups& of_view) {
    for_each_set(source, view, problem, [&](SampleSet& set) {
      add_log_errors(set, model, of_view);
      for (const Run& r : set.sort_by(theta_h_row))
        add_quadratic(set.cells(), r.begin, r.end, model, robust_scale, Curvature::gauss_newton, of_view.rows[static_cast<std::size_t>(r.key)]);
      for (const Run& r : set.sort_by(theta_d_column))
        add_quadratic(set.cells(), r.begin, r.end, model, robust_scale, Curvature::gauss_newton, of_view.columns[static_cast<std::size_t>(r.key)]);
    });
    of_view.views.emplace_back();
    for (const Sums& row : of_view.rows) add_all(row, of_view.views.back());
  });
  result.mean_abs_log = groups.n_log ? groups.sum_log / static_cast<double>(groups.n_log) : 0;
  result.rms_log = groups.n_log ? std::sqrt(groups.squares_log / static_cast<double>(groups.n_log)) : 0;
  GroupedQuadratics q;
  Sums all{};
  const auto keep = [&](const std::vector<Sums>& from, std::vector<Quadratic>& to) {
    for (const Sums& sums : from) {
      Quadratic one = quadratic_of(problem.layout, sums, model, 0, 0);
      if (one.curvature[0] > 0 || one.cost > 0) to.push_back(std::move(one));
    }
  };
  for (const Sums& row : groups.rows) add_all(row, all);
  keep(groups.rows, q.theta_h_rows);
  keep(groups.columns, q.theta_d_columns);
  keep(groups.views, q.views);
  q.all = quadratic_of(problem.layout, all, model, problem.energy_weight, n_values);
  return q;
}

}  // namespace

FitResult fit_samples(const SampleSource& source, const FitResult& table_fit, bool absolute_scale, const std::vector<SampleSource>& perturbed,
                      const Progress& progress) {
  const auto start = std::chrono::steady_clock::now();
  const FitOptions& options = table_fit.options;
  Problem problem{table_fit, ParameterLayout(source.n_channels, structure_of(table_fit)), absolute_scale ? options.energy_weight : 0.0};
  std::size_t passes = 0;
  const auto pass_done = [&] {
    if (progress) progress("fit to samples", ++passes, 0);
  };
  const Overview seen = overview(source, problem);
  pass_done();
  if (seen.n_values < 2 * static_cast<std::size_t>(problem.layout.size()))
    throw Error(ErrorCode::input, fmt::format("samples: {} usable ones are too few for {} parameters, expected at least {}", seen.n_values,
                                              problem.layout.size(), 2 * problem.layout.size()));
  if (table_fit.shared_error > 0)
    for (const double weight : seen.weight)
      problem.group_factor.push_back(static_cast<float>(1 / std::sqrt(1 + table_fit.shared_error * table_fit.shared_error * weight)));

  const auto quadratic_at = [&](const std::vector<double>& x, Curvature kind) {
    const brdf::CookTorrance model = problem.layout.unpack(x);
    Quadratic q = quadratic_of(problem.layout, pass(source, problem, model, kind), model, problem.energy_weight, seen.n_values);
    pass_done();
    return q;
  };
  const SolverOptions solver{.min_m = options.min_m, .max_iterations = options.max_iterations, .insignificant = 1e-4, .damping = 0};
  const Solution solution = minimise(quadratic_at, problem.layout, problem.layout.pack(table_fit.model), solver);

  FitResult result = table_fit;
  result.model = problem.layout.unpack(solution.x);
  result.converged = solution.converged;
  result.message = solution.message;
  result.n_cells = result.n_cells_available = seen.n_values + seen.n_bounds;
  result.n_residuals = seen.n_values;
  result.n_bounds = seen.n_bounds;
  const GroupedQuadratics q = grouped(source, problem, result.model, seen.n_values, result);
  pass_done();
  add_uncertainty(problem.layout, solution.x, q, seen.n_values, options.min_m, result);
  add_scale_error(table_fit.scale_sigma, result);
  const glm::dvec3 albedo = normal_incidence_albedo(result.model);
  result.energy = std::max({albedo.x, albedo.y, albedo.z});
  std::vector<Quadratic> moved;
  for (const SampleSource& p : perturbed) {
    moved.push_back(quadratic_of(problem.layout, pass(p, problem, result.model, Curvature::gauss_newton), result.model, 0, 0));
    pass_done();
  }
  add_calibration_error(problem.layout, q.all, moved, result);
  result.seconds = table_fit.seconds + std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return result;
}

}  // namespace lacquer::fit
