#include "libcalib/drift_fit.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "libbrdf/error.h"

namespace lacquer::calib {

namespace {

using Model = LightDrift::Model;

constexpr double significance = 0.01;
constexpr std::size_t min_points = 5;

double second_basis(const LightDrift& d, double t) { return d.model == Model::warm_up ? std::exp(-t / d.time_constant_s) : t; }

/// All models are linear in the points' intensities: the value at `t` is sum_k l_k y_k. Weighted regression on {1, g(t)}; `smooth`
/// weighs by nearness too.
std::vector<double> smoother(const LightDrift& d, double t) {
  const std::size_t n = d.points.size();
  std::vector<double> weights(n), l(n);
  double s0 = 0, s1 = 0, s2 = 0;
  // Relative to its value at t: then the value there is the first coefficient.
  const auto g = [&](std::size_t k) { return d.model == Model::none ? 0.0 : second_basis(d, d.points[k].time_s) - second_basis(d, t); };
  for (std::size_t k = 0; k < n; ++k) {
    const DriftPoint& p = d.points[k];
    const double u = (p.time_s - t) / d.time_constant_s;
    weights[k] = (d.model == Model::smooth ? std::exp(-u * u / 2) : 1.0) / (p.sigma * p.sigma + d.light_noise * d.light_noise);
    s0 += weights[k], s1 += weights[k] * g(k), s2 += weights[k] * g(k) * g(k);
  }
  const double determinant = s0 * s2 - s1 * s1;
  const bool constant = d.model == Model::none || !(determinant > 1e-12 * s0 * s2);
  for (std::size_t k = 0; k < n; ++k) l[k] = weights[k] * (constant ? 1 / s0 : (s2 - s1 * g(k)) / determinant);
  return l;
}

double apply(const std::vector<double>& l, const LightDrift& d) {
  double sum = 0;
  for (std::size_t k = 0; k < l.size(); ++k) sum += l[k] * d.points[k].intensity;
  return sum;
}

/// How well a model fits, with the light noise that it holds.
struct Judgement {
  double chi2 = 0, parameters = 0;
};

Judgement judge(const LightDrift& d) {
  Judgement j;
  j.parameters = d.model == Model::warm_up ? 1 : 0;  // its time constant; a bandwidth is no parameter, its effect is in the trace
  for (std::size_t k = 0; k < d.points.size(); ++k) {
    const auto l = smoother(d, d.points[k].time_s);
    const DriftPoint& p = d.points[k];
    const double r = p.intensity - apply(l, d);
    j.chi2 += r * r / (p.sigma * p.sigma + d.light_noise * d.light_noise);
    j.parameters += l[k];
  }
  return j;
}

/// Light noise with which chi2 is the number of degrees of freedom; 0 where the points' own sigmas are enough.
void find_light_noise(LightDrift& d) {
  const auto excess = [&](double noise) {
    d.light_noise = noise;
    const Judgement j = judge(d);
    return j.chi2 - (static_cast<double>(d.points.size()) - j.parameters);
  };
  if (excess(0) <= 0) return;
  double low = 0, high = 1e-6;
  while (excess(high) > 0 && high < 10) high *= 2;
  for (int i = 0; i < 40; ++i) (excess((low + high) / 2) > 0 ? low : high) = (low + high) / 2;
  d.light_noise = (low + high) / 2;
}

/// Time constant with the smallest sum of squared errors of prediction, each point predicted from the others.
double prediction_error(const LightDrift& d) {
  double sum = 0;
  for (std::size_t k = 0; k < d.points.size(); ++k) {
    const auto l = smoother(d, d.points[k].time_s);
    const DriftPoint& p = d.points[k];
    const double r = (p.intensity - apply(l, d)) / std::max(1 - l[k], 1e-6);  // residual if point k were left out
    sum += r * r / (p.sigma * p.sigma + d.light_noise * d.light_noise);
  }
  return sum;
}

LightDrift fitted(const std::vector<DriftPoint>& points, Model model) {
  LightDrift best;
  best.model = model;
  best.points = points;
  if (model == Model::warm_up || model == Model::smooth) {
    const double span = points.back().time_s - points.front().time_s, step = span / static_cast<double>(points.size() - 1);
    // Longer time constants look like a line, shorter ones see no more than one point.
    const double shortest = model == Model::smooth ? 1.5 * step : step / 2, longest = model == Model::smooth ? span / 2 : 3 * span;
    double smallest = INFINITY, constant = longest;
    for (double t = shortest; t <= longest * (1 + 1e-9); t *= 1.15) {
      LightDrift trial = best;
      trial.time_constant_s = t;
      const double error = model == Model::smooth ? prediction_error(trial) : judge(trial).chi2;
      if (error < smallest) smallest = error, constant = t;
    }
    best.time_constant_s = constant;
  }
  find_light_noise(best);
  return best;
}

/// Is `richer` better than `simpler` by more than chance? Both are judged with the light noise of the richer one.
bool significantly_better(const LightDrift& richer, LightDrift simpler) {
  simpler.light_noise = richer.light_noise;
  const Judgement a = judge(simpler), b = judge(richer);
  const double n = static_cast<double>(richer.points.size()), d1 = std::max(b.parameters - a.parameters, 1.0), d2 = n - b.parameters;
  if (!(d2 >= 1) || !(a.chi2 > b.chi2)) return false;
  return f_tail((a.chi2 - b.chi2) / d1 / std::max(b.chi2 / d2, 1.0), d1, d2) < significance;
}

std::vector<DriftPoint> sorted(std::vector<DriftPoint> points) {
  std::sort(points.begin(), points.end(), [](const DriftPoint& a, const DriftPoint& b) { return a.time_s < b.time_s; });
  for (std::size_t k = 0; k < points.size(); ++k) {
    const DriftPoint& p = points[k];
    if (!std::isfinite(p.time_s) || !(p.intensity > 0 && std::isfinite(p.intensity)) || !(p.sigma > 0 && std::isfinite(p.sigma)))
      throw Error(ErrorCode::input, fmt::format("light drift: point {}: expected a finite time, intensity > 0 and sigma > 0, got {}, {}, {}",
                                                k + 1, p.time_s, p.intensity, p.sigma));
    if (k > 0 && p.time_s == points[k - 1].time_s)
      throw Error(ErrorCode::input, fmt::format("light drift: expected points at different times, two are at {} s", p.time_s));
  }
  return points;
}

/// Continued fraction of the incomplete beta function (Abramowitz and Stegun 26.5.8), by Lentz's method.
double beta_fraction(double x, double a, double b) {
  constexpr double tiny = 1e-300;
  double c = 1, d = 1 - (a + b) * x / (a + 1);
  d = 1 / (std::abs(d) < tiny ? tiny : d);
  double h = d;
  for (int m = 1; m < 10000; ++m) {
    const double m2 = 2.0 * m;
    for (const double term : {m * (b - m) * x / ((a + m2 - 1) * (a + m2)), -(a + m) * (a + b + m) * x / ((a + m2) * (a + m2 + 1))}) {
      d = 1 + term * d;
      d = 1 / (std::abs(d) < tiny ? tiny : d);
      c = 1 + term / c;
      if (std::abs(c) < tiny) c = tiny;
      h *= d * c;
    }
    if (std::abs(d * c - 1) < 1e-14) break;
  }
  return h;
}

}  // namespace

double f_tail(double f, double d1, double d2) {
  // I_x(a, b), the regularised incomplete beta function
  const double a = d2 / 2, b = d1 / 2, x = d2 / (d2 + d1 * f);
  if (x <= 0) return 0;
  if (x >= 1) return 1;
  const double front = std::exp(std::lgamma(a + b) - std::lgamma(a) - std::lgamma(b) + a * std::log(x) + b * std::log1p(-x));
  return x < (a + 1) / (a + b + 2) ? front * beta_fraction(x, a, b) / a : 1 - front * beta_fraction(1 - x, b, a) / b;
}

DriftValue evaluate_drift(const LightDrift& d, double time_s) {
  if (d.model == Model::none || d.points.empty()) return {1, 0};
  if (d.model == Model::per_view) {
    const auto near = std::min_element(d.points.begin(), d.points.end(), [&](const DriftPoint& a, const DriftPoint& b) {
      return std::abs(a.time_s - time_s) < std::abs(b.time_s - time_s);
    });
    const double factor = near->intensity / d.start;
    return {factor, std::hypot(near->sigma, factor * d.start_sigma) / d.start};
  }
  const auto start = smoother(d, d.points.front().time_s), now = smoother(d, time_s);
  const double at_start = apply(start, d), factor = apply(now, d) / at_start;
  double variance = 0;
  for (std::size_t k = 0; k < now.size(); ++k) {
    const DriftPoint& p = d.points[k];
    variance += std::pow((now[k] - factor * start[k]) / at_start, 2) * (p.sigma * p.sigma + d.light_noise * d.light_noise);
  }
  return {factor, std::sqrt(variance)};
}

namespace {

/// Level of the model at its first point and the standard error of that.
DriftValue level_at_start(const LightDrift& d) {
  const auto l = smoother(d, d.points.front().time_s);
  double variance = 0;
  for (std::size_t k = 0; k < l.size(); ++k)
    variance += l[k] * l[k] * (d.points[k].sigma * d.points[k].sigma + d.light_noise * d.light_noise);
  return {apply(l, d), std::sqrt(variance)};
}

}  // namespace

LightDrift fit_drift(std::vector<DriftPoint> points) {
  points = sorted(std::move(points));
  LightDrift best;
  best.points = points;
  if (points.size() < 2) return best;
  best = fitted(points, Model::none);
  if (points.size() < min_points) return best;
  for (const Model model : {Model::linear, Model::warm_up, Model::smooth}) {
    const LightDrift richer = fitted(points, model);
    if (significantly_better(richer, best)) best = richer;
  }
  return best;
}

LightDrift follow_each_view(std::vector<DriftPoint> points) {
  LightDrift drift;
  drift.points = sorted(std::move(points));
  if (drift.points.size() < 2) return drift;
  const Judgement constant = judge(drift);
  constexpr double many = 1e7;  // F with so many degrees of freedom is chi-square: the sigmas are known
  const double d1 = static_cast<double>(drift.points.size()) - 1;
  if (f_tail(constant.chi2 / d1, d1, many) >= significance) return drift;
  drift.model = Model::per_view;
  constexpr std::size_t near_start = 200;
  const auto end = drift.points.begin() + static_cast<std::ptrdiff_t>(std::min(near_start, drift.points.size()));
  const DriftValue start = level_at_start(fit_drift({drift.points.begin(), end}));
  drift.start = start.factor;
  drift.start_sigma = start.sigma;
  return drift;
}

}  // namespace lacquer::calib
