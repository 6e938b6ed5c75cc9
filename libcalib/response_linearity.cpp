#include "libcalib/response_linearity.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <optional>

#include "libcalib/response_solver.h"

namespace lacquer::calib {

namespace {

constexpr std::size_t n_shapes = 8;
constexpr double significance = 0.01, smallest_deviation = 5e-4;
/// Pixels per channel that a black level or an obvious curve are found with.
constexpr std::size_t few_pixels = 1500;

/// P(chi-square > x) for an even number of degrees of freedom.
double chi_square_tail(double x, std::size_t dof) {
  double term = std::exp(-x / 2), sum = term;
  for (std::size_t i = 1; i < dof / 2; ++i) sum += term *= x / 2 / static_cast<double>(i);
  return std::clamp(sum, 0.0, 1.0);
}

std::array<double, n_shapes> legendre(double x) {
  std::array<double, n_shapes> result{};
  double before = 1, p = x;
  for (std::size_t k = 0; k < n_shapes; ++k) {
    result[k] = p;
    const double n = static_cast<double>(k) + 1;
    const double next = ((2 * n + 1) * x * p - n * before) / (n + 1);
    before = p;
    p = next;
  }
  return result;
}

/// Coordinates of the spline between which a channel's values hold information.
struct Range {
  double low, high;
  double relative(double c) const { return std::clamp(2 * (c - low) / std::max(high - low, 1e-9) - 1, -1.0, 1.0); }
};

Range data_range(const ResponseSolver& solver, const SymmetricMatrix& a, std::size_t channel) {
  const std::size_t offset = solver.first_coefficient(channel), n = solver.channels()[channel].coefficients().size();
  double largest = 0;
  for (std::size_t k = 0; k < n; ++k) largest = std::max(largest, a(offset + k, offset + k));
  std::size_t first = n - 1, last = 0;
  for (std::size_t k = 0; k < n; ++k)
    if (a(offset + k, offset + k) > 1e-6 * largest) {
      first = std::min(first, k);
      last = std::max(last, k);
    }
  // Coefficient k is centred at coordinate k - 1.
  return {std::max(static_cast<double>(first) - 1, 0.0), std::max(static_cast<double>(last) - 1, static_cast<double>(first))};
}

/// What is estimated: shapes of all channels, change of the black level, e_j. A column holds its values at the centres of the spline's
/// coefficients, which is close enough for shapes as smooth as these.
struct Columns {
  std::size_t n_channels, n_times;
  std::size_t black() const { return n_channels * n_shapes; }
  std::size_t time(std::size_t j) const { return black() + 1 + j; }
  std::size_t size() const { return time(n_times); }
  std::vector<std::vector<double>> shapes;  ///< per channel: n_shapes + 1 values per coefficient, the last for the black level
};

Columns make_columns(const ResponseSolver& solver, const std::vector<Range>& ranges) {
  Columns columns{solver.channels().size(), solver.log_time_corrections().size(), {}};
  for (std::size_t c = 0; c < columns.n_channels; ++c) {
    const ResponseChannel& channel = solver.channels()[c];
    auto& shapes = columns.shapes.emplace_back();
    for (std::size_t k = 0; k < channel.coefficients().size(); ++k) {
      const double place = static_cast<double>(k) - 1;
      for (const double p : legendre(ranges[c].relative(place))) shapes.push_back(p);
      shapes.push_back(-std::exp(-channel.spline().log_signal(place)));  // d ln(v - black) / d black
    }
  }
  return columns;
}

/// Q^T A Q, Q the matrix of the columns.
SymmetricMatrix project(const ResponseSolver& solver, const Columns& columns, const SymmetricMatrix& a) {
  constexpr std::size_t width = n_shapes + 1;
  SymmetricMatrix result(columns.size());
  const std::size_t first_time = solver.first_time();
  const auto column = [&](std::size_t c, std::size_t s) { return s < n_shapes ? c * n_shapes + s : columns.black(); };
  for (std::size_t c = 0; c < columns.n_channels; ++c) {
    const auto& shapes = columns.shapes[c];
    const std::size_t offset = solver.first_coefficient(c), n = shapes.size() / width;
    for (std::size_t s = 0; s < width; ++s) {
      std::vector<double> product(a.size());  // A times the column
      for (std::size_t i = 0; i < n; ++i)
        for (std::size_t k = 0; k < n; ++k) product[offset + i] += a(offset + i, offset + k) * shapes[k * width + s];
      for (std::size_t j = 0; j < columns.n_times; ++j)
        for (std::size_t k = 0; k < n; ++k) result.at(columns.time(j), column(c, s)) += a(first_time + j, offset + k) * shapes[k * width + s];
      for (std::size_t r = 0; r < width; ++r) {
        const std::size_t row = column(c, r), col = column(c, s);
        if (row < col) continue;
        for (std::size_t i = 0; i < n; ++i) result.at(row, col) += shapes[i * width + r] * product[offset + i];
      }
    }
  }
  for (std::size_t j = 0; j < columns.n_times; ++j)
    for (std::size_t k = 0; k <= j; ++k) result.at(columns.time(j), columns.time(k)) = a(first_time + j, first_time + k);
  return result;
}

std::vector<double> project(const ResponseSolver& solver, const Columns& columns, const std::vector<double>& b) {
  constexpr std::size_t width = n_shapes + 1;
  std::vector<double> result(columns.size());
  for (std::size_t c = 0; c < columns.n_channels; ++c)
    for (std::size_t k = 0; k < columns.shapes[c].size() / width; ++k)
      for (std::size_t s = 0; s < width; ++s)
        result[s < n_shapes ? c * n_shapes + s : columns.black()] += columns.shapes[c][k * width + s] * b[solver.first_coefficient(c) + k];
  for (std::size_t j = 0; j < columns.n_times; ++j) result[columns.time(j)] = b[solver.first_time() + j];
  return result;
}

/// Solution and covariance for some of the columns, ascending.
struct Solution {
  std::vector<double> x;
  SymmetricMatrix covariance;
};

Solution solve_for(const std::vector<std::size_t>& columns, const SymmetricMatrix& a, const SymmetricMatrix& scatter, const std::vector<double>& b) {
  SymmetricMatrix own(columns.size()), own_scatter(columns.size());
  std::vector<double> own_b;
  for (std::size_t i = 0; i < columns.size(); ++i) {
    own_b.push_back(b[columns[i]]);
    for (std::size_t j = 0; j <= i; ++j) {
      own.at(i, j) = a(columns[i], columns[j]);
      own_scatter.at(i, j) = scatter(columns[i], columns[j]);
    }
  }
  std::vector<double> x = solve(own, std::move(own_b));
  return {std::move(x), sandwich(std::move(own), own_scatter)};
}

std::vector<std::size_t> numbers_from(std::size_t first, std::size_t last) {
  std::vector<std::size_t> result(last - first);
  std::iota(result.begin(), result.end(), first);
  return result;
}

/// Deviation from the line, less what noise alone would give, and that part of noise; over 64 levels even between the limits of the data.
void measure_deviation(const ResponseSolver& solver, std::size_t channel, const Range& range, const Solution& solution,
                       LinearityTest::Channel& result) {
  constexpr std::size_t n_levels = 64;
  const ResponseSpline& spline = solver.channels()[channel].spline();
  const double low = std::exp(spline.log_signal(range.low)), high = std::exp(spline.log_signal(range.high));
  std::array<std::array<double, n_shapes>, n_levels> levels{};
  std::array<double, n_shapes> mean{};
  for (std::size_t i = 0; i < n_levels; ++i) {
    const double signal = low + (high - low) * (static_cast<double>(i) + 0.5) / n_levels;
    levels[i] = legendre(range.relative(spline.coordinate(std::log(signal))));
    for (std::size_t k = 0; k < n_shapes; ++k) mean[k] += levels[i][k] / n_levels;
  }
  const std::size_t offset = channel * n_shapes;
  double squares = 0, noise = 0;
  for (const auto& level : levels) {
    std::vector<double> x(n_shapes);
    double deviation = 0;
    for (std::size_t k = 0; k < n_shapes; ++k) {
      x[k] = level[k] - mean[k];
      deviation += x[k] * solution.x[offset + k];
    }
    squares += deviation * deviation / n_levels;
    noise += solution.covariance.quadratic_form(offset, x) / n_levels;
  }
  result.deviation_rms = std::sqrt(std::max(0.0, squares - noise));
  result.deviation_sigma = std::sqrt(std::max(0.0, noise));
}

/// Everything at one black level.
class LineAt {
 public:
  LineAt(const BracketSamples& samples, const NoiseModel& known, double black)
      : noise_(known), solver_(samples.bits, black, saturation_value(known, samples.bits), samples) {
    round_.time_sigma = loose_time_sigma;
    noise_.black_level_dn = black;
    const Response line = linear_response(samples.bits, static_cast<int>(samples.channels.size()), black);
    round_.pixel_step = samples.step_to(noise_pixels);
    const BracketSamples noise_samples = samples.thinned(round_.pixel_step);
    for (int i = 0; i < 3; ++i) {
      solver_.refine_times(round_);
      noise_ = estimate_noise(noise_samples.with_times(solver_.log_time_corrections()), line, noise_);
      noise_.relative_noise = std::min(noise_.relative_noise, 0.05);
      round_.noise = &noise_;
      round_.time_sigma = solver_.spread_of_times();
    }
    round_.pixel_step = 1;
    solver_.refine_times(round_);
    auto equations = solver_.equations(round_, true);
    for (std::size_t c = 0; c < solver_.channels().size(); ++c) ranges_.push_back(data_range(solver_, equations.a, c));
    columns_ = make_columns(solver_, ranges_);
    a_ = project(solver_, columns_, equations.a);
    scatter_ = project(solver_, columns_, equations.scatter);
    b_ = project(solver_, columns_, equations.b);
    for (std::size_t j = 0; j < columns_.n_times; ++j) {
      const double precision = solver_.time_precision(j, round_.time_sigma);
      a_.at(columns_.time(j), columns_.time(j)) += precision;
      scatter_.at(columns_.time(j), columns_.time(j)) += precision;
      b_[columns_.time(j)] -= precision * solver_.log_time_corrections()[j];
    }
  }
  LineAt(const LineAt&) = delete;
  LineAt& operator=(const LineAt&) = delete;

  /// Change of the black level that makes the line fit best, and its sigma.
  std::pair<double, double> black_change() const {
    const Solution s = solve_for(numbers_from(columns_.black(), columns_.size()), a_, scatter_, b_);
    return {s.x[0], std::sqrt(std::max(0.0, s.covariance(0, 0)))};
  }

  std::vector<LinearityTest::Channel> channels() const {
    const Solution s = solve_for(numbers_from(0, columns_.size()), a_, scatter_, b_);
    // How far from the line: with the black level as it is, or shapes and black level would share one deviation between them.
    std::vector<std::size_t> no_black = numbers_from(0, columns_.size());
    no_black.erase(no_black.begin() + static_cast<std::ptrdiff_t>(columns_.black()));
    const Solution at_black = solve_for(no_black, a_, scatter_, b_);
    std::vector<LinearityTest::Channel> result;
    for (std::size_t c = 0; c < columns_.n_channels; ++c) {
      auto& channel = result.emplace_back();
      SymmetricMatrix own(n_shapes);
      std::vector<double> x(n_shapes);
      for (std::size_t i = 0; i < n_shapes; ++i) {
        x[i] = s.x[c * n_shapes + i];
        for (std::size_t j = 0; j <= i; ++j) own.at(i, j) = s.covariance(c * n_shapes + i, c * n_shapes + j);
      }
      const std::vector<double> weighted = solve(own, x);
      for (std::size_t i = 0; i < n_shapes; ++i) channel.chi_square += x[i] * weighted[i];
      channel.p_value = chi_square_tail(channel.chi_square, n_shapes);
      measure_deviation(solver_, c, ranges_[c], at_black, channel);
      channel.linear = channel.p_value >= significance / static_cast<double>(columns_.n_channels) || channel.deviation_rms < smallest_deviation;
    }
    return result;
  }

 private:
  NoiseModel noise_;
  ResponseSolver solver_;
  ResponseSolver::Round round_;
  std::vector<Range> ranges_;
  Columns columns_{};
  SymmetricMatrix a_, scatter_;
  std::vector<double> b_;
};

bool obviously_curved(const std::vector<LinearityTest::Channel>& channels) {
  return std::any_of(channels.begin(), channels.end(),
                     [](const auto& c) { return !c.linear && c.p_value < 1e-12 && c.deviation_rms > 0.02; });
}

}  // namespace

LinearityTest test_linearity(const BracketSamples& samples, const NoiseModel& known) {
  constexpr double contradiction = 4;  // sigmas
  const std::size_t step = samples.step_to(few_pixels);
  const BracketSamples few = samples.thinned(step);

  LinearityTest test;
  double black = known.black_level_dn;
  std::optional<LineAt> line;
  for (int i = 0; i < 6; ++i) {
    line.emplace(few, known, black);
    const auto [change, sigma] = line->black_change();
    if (std::abs(change) <= std::max(0.5 * sigma, 1e-3)) break;
    if (i >= 2 && obviously_curved(line->channels())) break;  // no black level will straighten that
    black = std::clamp(black + change, 0.0, 0.25 * std::exp2(samples.bits));
  }
  // As given, unless the data say otherwise.
  test.black_level_dn = known.black_level_dn;
  const auto [change, sigma] = line->black_change();
  if (std::abs(black - known.black_level_dn) < contradiction * sigma) {
    black = known.black_level_dn;
    line.emplace(few, known, black);
  }
  test.channels = line->channels();
  if (step > 1 && !obviously_curved(test.channels)) {
    line.emplace(samples, known, black);
    test.channels = line->channels();
  }
  test.linear = std::all_of(test.channels.begin(), test.channels.end(), [](const auto& c) { return c.linear; });
  const auto [last_change, last_sigma] = line->black_change();
  test.fitted_black_level_dn = black + last_change;
  test.black_level_sigma_dn = last_sigma;
  if (!test.linear) return test;
  test.black_level_contradicted = std::abs(test.fitted_black_level_dn - known.black_level_dn) > contradiction * last_sigma &&
                                  std::abs(test.fitted_black_level_dn - known.black_level_dn) > 0.05;
  if (test.black_level_contradicted) test.black_level_dn = std::max(0.0, test.fitted_black_level_dn);
  return test;
}

}  // namespace lacquer::calib
