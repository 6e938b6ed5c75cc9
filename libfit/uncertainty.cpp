#include "libfit/uncertainty.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace lacquer::fit {

namespace {

/// Below this eigenvalue of the correlation-scaled matrix (trace n) a direction carries nothing but rounding
/// errors.
constexpr double null_eigenvalue = 1e-13;
/// Share of a parameter in the null directions from which it counts as undetermined.
constexpr double null_share = 1e-6;

/// Parameters that can have a sigma at all: not those of a lobe that is off, nor those the objective does not
/// react to.
std::vector<int> live_parameters(const ParameterLayout& layout, const std::vector<double>& x,
                                 const Quadratic& q) {
  std::vector<bool> live(x.size(), true);
  for (int l = 0; l < layout.n_lobes(); ++l) {
    bool off = true;
    for (int c = 0; c < layout.n_channels(); ++c) off &= x[layout.ks(l, c)] <= 0;
    if (!off) continue;
    for (int c = 0; c < layout.n_channels(); ++c) live[layout.ks(l, c)] = false;
    live[layout.log_m(l)] = live[layout.r(l)] = false;
  }
  std::vector<int> indices;
  const int n = layout.size();
  for (int k = 0; k < n; ++k)
    if (live[k] && q.curvature[k * n + k] > 0) indices.push_back(k);
  return indices;
}

struct Inverse {
  std::vector<double> covariance;  // of the live parameters
  std::vector<bool> determined;
};

/// Pseudo-inverse of the Gauss-Newton matrix on the live parameters; null directions are dropped and those
/// who live in them named.
Inverse invert(const Quadratic& q, int n, const std::vector<int>& live) {
  const int size = static_cast<int>(live.size());
  std::vector<double> scale(live.size()), scaled(live.size() * live.size());
  for (int i = 0; i < size; ++i) scale[i] = 1 / std::sqrt(q.curvature[live[i] * n + live[i]]);
  for (int i = 0; i < size; ++i)
    for (int j = 0; j < size; ++j)
      scaled[i * size + j] = q.curvature[live[i] * n + live[j]] * scale[i] * scale[j];

  const Eigensystem eigen = symmetric_eigensystem(scaled, size);
  Inverse result{.covariance = std::vector<double>(scaled.size()),
                 .determined = std::vector<bool>(live.size(), true)};
  for (int i = 0; i < size; ++i) {
    double in_null_space = 0;
    for (int k = 0; k < size; ++k)
      if (eigen.values[k] < null_eigenvalue)
        in_null_space += eigen.vectors[k * size + i] * eigen.vectors[k * size + i];
    result.determined[i] = in_null_space < null_share;
    for (int j = 0; j < size; ++j) {
      double sum = 0;
      for (int k = 0; k < size; ++k)
        if (eigen.values[k] >= null_eigenvalue)
          sum += eigen.vectors[k * size + i] * eigen.vectors[k * size + j] / eigen.values[k];
      result.covariance[i * size + j] = sum * scale[i] * scale[j];
    }
  }
  return result;
}

/// What the rows or columns of the table say about the variance of a parameter.
struct Clusters {
  double variance = 0;            ///< if errors within a group may depend on each other and those of two groups do not; 0: cannot tell
  double degrees_of_freedom = 0;  ///< of `variance`, Satterthwaite's
};

/// Variance that the groups' gradients give to each live parameter; `covariance`: of the live parameters.
std::vector<Clusters> clusters(const std::vector<Quadratic>& groups, const std::vector<int>& live, const std::vector<double>& covariance) {
  std::vector<Clusters> result(live.size());
  if (groups.size() < 10) return result;  // too few to tell
  const std::size_t size = live.size(), n = groups.front().gradient.size();
  const auto n_groups = static_cast<double>(groups.size());
  for (std::size_t i = 0; i < size; ++i) {
    const double* row = &covariance[i * size];
    // Steps of the parameter that each group asks for, and their variances if its values were independent.
    std::vector<double> steps;
    double mean = 0, expected = 0, expected2 = 0;
    for (const Quadratic& g : groups) {
      double step = 0, variance = 0;
      for (std::size_t j = 0; j < size; ++j) {
        step += row[j] * g.gradient[live[j]];
        for (std::size_t k = 0; k < size; ++k) variance += row[j] * g.curvature[static_cast<std::size_t>(live[j]) * n + live[k]] * row[k];
      }
      steps.push_back(step);
      mean += step / n_groups;
      expected += variance;
      expected2 += variance * variance;
    }
    for (const double step : steps) result[i].variance += (step - mean) * (step - mean) * n_groups / (n_groups - 1);
    result[i].degrees_of_freedom = expected2 > 0 ? expected * expected / expected2 : 0;
  }
  return result;
}

/// chi^2 / degrees of freedom that chance exceeds once in 741 times (3 sigma), Wilson and Hilferty 1931.
double chance_limit(double degrees_of_freedom) {
  const double a = 2 / (9 * std::max(degrees_of_freedom, 0.5));
  return std::pow(1 - a + 3 * std::sqrt(a), 3);
}

double reduced_chi2(const Quadratic& q, std::size_t n_values, std::size_t n_parameters) {
  return q.cost / static_cast<double>(std::max<std::size_t>(1, n_values - std::min(n_values, n_parameters)));
}

/// Factor on each live parameter's sigma, see uncertainty.h.
std::vector<double> sigma_factors(const GroupedQuadratics& q, std::size_t n_values, double reduced, const std::vector<int>& live,
                                  const std::vector<double>& covariance) {
  const std::size_t size = live.size();
  std::vector<double> factors(size, reduced > chance_limit(static_cast<double>(n_values)) ? std::sqrt(reduced) : 1.0);
  for (const auto* groups : {&q.theta_h_rows, &q.theta_d_columns, &q.views}) {
    const std::vector<Clusters> found = clusters(*groups, live, covariance);
    for (std::size_t i = 0; i < size; ++i) {
      if (!(covariance[i * size + i] > 0)) continue;
      const double ratio = found[i].variance / covariance[i * size + i];
      if (ratio > chance_limit(found[i].degrees_of_freedom)) factors[i] = std::max(factors[i], std::sqrt(ratio));
    }
  }
  return factors;
}

}  // namespace

double overdispersion(const ParameterLayout& layout, const std::vector<double>& x, const GroupedQuadratics& q, std::size_t n_values) {
  const std::vector<int> live = live_parameters(layout, x, q.all);
  const Inverse inverse = invert(q.all, layout.size(), live);
  double factor = std::max(1.0, reduced_chi2(q.all, n_values, x.size()));
  for (const auto* groups : {&q.theta_h_rows, &q.theta_d_columns, &q.views}) {
    const std::vector<Clusters> found = clusters(*groups, live, inverse.covariance);
    double sum = 0;
    for (std::size_t i = 0; i < live.size(); ++i) {
      const double variance = inverse.covariance[i * live.size() + i];
      if (variance > 0) sum += found[i].variance / variance;
    }
    if (!live.empty()) factor = std::max(factor, sum / static_cast<double>(live.size()));
  }
  return factor;
}

bool every_lobe_shows(const FitResult& result) {
  constexpr double schlick_at_80_deg = 0.385, limit = 10;
  const std::size_t n = result.parameters.size();
  std::vector<bool> shows(result.model.lobes.size(), false);
  for (std::size_t i = 0; i < n; ++i) {
    const Parameter& ks = result.parameters[i];
    if (!ks.name.starts_with("ks")) continue;
    const std::string lobe = ks.name.substr(2, ks.name.find('.') - 2);
    std::size_t k = 0;
    while (result.parameters[k].name != "r" + lobe) ++k;
    const auto covariance = [&](std::size_t a, std::size_t b) { return result.covariance[a * n + b]; };
    for (const double weight : {0.0, schlick_at_80_deg}) {
      const double r = result.parameters[k].value, f = r + (1 - r) * weight, by_r = ks.value * (1 - weight);
      const double variance = f * f * covariance(i, i) + 2 * f * by_r * covariance(i, k) + by_r * by_r * covariance(k, k);
      // Without a standard error nothing can be said against the lobe, unless it is off.
      if (ks.value > 0 && (!(variance > 0) || ks.value * f > limit * std::sqrt(variance))) shows[std::stoul(lobe) - 1] = true;
    }
  }
  return std::all_of(shows.begin(), shows.end(), [](bool s) { return s; });
}

Eigensystem symmetric_eigensystem(std::vector<double> a, int n) {
  std::vector<double> v(a.size(), 0.0);
  for (int i = 0; i < n; ++i) v[i * n + i] = 1;
  for (int sweep = 0; sweep < 60; ++sweep) {
    double off_diagonal = 0;
    for (int p = 0; p < n; ++p)
      for (int q = p + 1; q < n; ++q) {
        const double apq = a[p * n + q];
        off_diagonal += std::abs(apq);
        if (apq == 0) continue;
        const double theta = (a[q * n + q] - a[p * n + p]) / (2 * apq);
        const double t = std::copysign(1.0, theta) / (std::abs(theta) + std::hypot(theta, 1.0));
        const double c = 1 / std::hypot(t, 1.0), s = t * c;
        for (int k = 0; k < n; ++k) {
          const double akp = a[k * n + p], akq = a[k * n + q];
          a[k * n + p] = c * akp - s * akq;
          a[k * n + q] = s * akp + c * akq;
        }
        for (int k = 0; k < n; ++k) {
          const double apk = a[p * n + k], aqk = a[q * n + k];
          a[p * n + k] = c * apk - s * aqk;
          a[q * n + k] = s * apk + c * aqk;
          const double vpk = v[p * n + k], vqk = v[q * n + k];
          v[p * n + k] = c * vpk - s * vqk;
          v[q * n + k] = s * vpk + c * vqk;
        }
      }
    if (off_diagonal == 0) break;
  }
  std::vector<int> order(static_cast<std::size_t>(n));
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int i, int j) { return a[i * n + i] < a[j * n + j]; });
  Eigensystem result;
  for (const int i : order) {
    result.values.push_back(a[i * n + i]);
    result.vectors.insert(result.vectors.end(), v.begin() + i * n, v.begin() + (i + 1) * n);
  }
  return result;
}

void add_uncertainty(const ParameterLayout& layout, const std::vector<double>& x, const GroupedQuadratics& quadratics,
                     std::size_t n_values, double min_m, FitResult& result) {
  const int n = layout.size();
  const Quadratic& q = quadratics.all;
  result.reduced_chi2 = reduced_chi2(q, n_values, x.size());

  const std::vector<double> lower = layout.lower_bounds(min_m), upper = layout.upper_bounds();
  const std::vector<std::string> names = layout.names();
  std::vector<double> to_public(x.size(), 1.0);  // d(public parameter) / d(solver's)
  std::vector<bool> is_shape(x.size(), false);
  result.parameters.clear();
  for (int k = 0; k < n; ++k)
    result.parameters.push_back({.name = names[k],
                                 .value = x[k],
                                 .at_bound = x[k] <= lower[k] || x[k] >= upper[k],
                                 .determined = false});
  for (int l = 0; l < layout.n_lobes(); ++l) {
    const int log_m = layout.log_m(l);
    result.parameters[log_m].value = to_public[log_m] = std::exp(x[log_m]);
    is_shape[log_m] = is_shape[layout.r(l)] = true;
  }
  const std::vector<int> live = live_parameters(layout, x, q);
  const Inverse inverse = invert(q, n, live);
  const std::vector<double> factors = sigma_factors(quadratics, n_values, result.reduced_chi2, live, inverse.covariance);
  std::vector<int> sound;  // positions in `live`
  for (std::size_t i = 0; i < live.size(); ++i) {
    const double sigma = std::sqrt(inverse.covariance[i * live.size() + i]) * factors[i];  // of ln(m) for m
    if (!inverse.determined[i] || (is_shape[live[i]] && sigma > 1)) continue;
    result.parameters[live[i]].determined = true;
    result.parameters[live[i]].sigma = sigma * to_public[live[i]];
    result.parameters[live[i]].inflation = factors[i];
    // So near that the difference means nothing.
    const double margin = 0.1 * sigma;
    result.parameters[live[i]].at_bound |= x[live[i]] - lower[live[i]] < margin || upper[live[i]] - x[live[i]] < margin;
    sound.push_back(static_cast<int>(i));
  }
  // A lobe that is off is known to be off; its shape is not known.
  for (int l = 0; l < layout.n_lobes(); ++l) {
    bool off = true;
    for (int c = 0; c < layout.n_channels(); ++c) off &= x[layout.ks(l, c)] <= 0;
    for (int c = 0; off && c < layout.n_channels(); ++c) result.parameters[layout.ks(l, c)].determined = true;
  }
  result.covariance.assign(x.size() * x.size(), 0.0);
  for (const int i : sound)
    for (const int j : sound)
      result.covariance[live[i] * n + live[j]] =
          inverse.covariance[i * live.size() + static_cast<std::size_t>(j)] * factors[i] * factors[j] *
          to_public[live[i]] * to_public[live[j]];
}

void add_scale_error(double scale_sigma, FitResult& result) {
  result.scale_sigma = scale_sigma;
  const std::size_t n = result.parameters.size();
  const auto scales = [&](std::size_t i) { return result.parameters[i].name[0] == 'k' && result.parameters[i].sigma > 0; };
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = 0; j < n; ++j)
      if (scales(i) && scales(j))
        result.covariance[i * n + j] += scale_sigma * scale_sigma * result.parameters[i].value * result.parameters[j].value;
  for (std::size_t i = 0; i < n; ++i)
    if (scales(i)) result.parameters[i].sigma = std::sqrt(result.covariance[i * n + i]);
}

void add_half_vector_error(double sigma, FitResult& result) {
  const std::size_t n = result.parameters.size();
  for (std::size_t i = 0; i < n; ++i) {
    Parameter& p = result.parameters[i];
    if (p.name[0] != 'm' || !(p.sigma > 0)) continue;
    p.calibration_sigma = std::hypot(p.value, sigma) - p.value;
    result.covariance[i * n + i] += p.calibration_sigma * p.calibration_sigma;
    p.sigma = std::sqrt(result.covariance[i * n + i]);
  }
}

void add_calibration_error(const ParameterLayout& layout, const Quadratic& here, const std::vector<Quadratic>& moved, FitResult& result) {
  const auto n = static_cast<std::size_t>(layout.size());
  std::vector<int> live;  // what has an error can have this one too
  std::vector<double> to_public(n, 1.0);
  for (int l = 0; l < layout.n_lobes(); ++l) to_public[static_cast<std::size_t>(layout.log_m(l))] = result.parameters[layout.log_m(l)].value;
  for (std::size_t i = 0; i < n; ++i)
    if (result.parameters[i].sigma > 0) live.push_back(static_cast<int>(i));
  const Inverse inverse = invert(here, layout.size(), live);
  for (const Quadratic& q : moved) {
    std::vector<double> step(n);
    for (std::size_t i = 0; i < live.size(); ++i)
      for (std::size_t j = 0; j < live.size(); ++j)
        step[live[i]] -= inverse.covariance[i * live.size() + j] * (q.gradient[live[j]] - here.gradient[live[j]]) * to_public[live[i]];
    for (const int i : live) {
      result.parameters[i].calibration_sigma = std::hypot(result.parameters[i].calibration_sigma, step[i]);
      for (const int j : live) result.covariance[static_cast<std::size_t>(i) * n + j] += step[i] * step[j];
    }
  }
  for (const int i : live) result.parameters[i].sigma = std::sqrt(result.covariance[static_cast<std::size_t>(i) * n + i]);
}

}  // namespace lacquer::fit
