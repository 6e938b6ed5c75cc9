#include "libfit/material_refit.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <vector>

namespace lacquer::fit {

namespace {

using Vector = std::vector<double>;
constexpr double pi = std::numbers::pi;
/// Pull of each parameter to its start: decides what the values leave open (two lobes of one width may share a colour in any way).
constexpr double prior = 0.2;
constexpr double tiny = 1e-30;  // keeps the logarithm of a value that underflowed finite

/// One direction with the logarithm of the model's value there.
struct Target {
  brdf::Directions d;
  glm::dvec3 log_value;
  double weight;
};

std::vector<Target> targets_of(const brdf::CookTorrance& model) {
  const double min_cosine = std::cos(80 * pi / 180);
  std::vector<Target> targets;
  for (int h = 0; h < 40; ++h)
    for (int t = 0; t < 12; ++t)
      for (int p = 0; p < 5; ++p) {
        const double x = (h + 0.5) / 40;
        const brdf::Directions d = brdf::directions({x * x * pi / 2, (t + 0.5) / 12 * pi / 2, (p + 0.5) / 5 * pi});
        if (std::min(d.wi.z, d.wo.z) <= min_cosine) continue;
        glm::dvec3 log_value = model.log_value(brdf::half_angle_cosines(d));
        for (int c = 0; c < 3; ++c) log_value[c] = std::max(log_value[c], std::log(tiny));
        targets.push_back({d, log_value, std::sqrt(d.wi.z * d.wo.z)});
      }
  return targets;
}

/// A vector of parameters with its bounds and what it means.
template <typename Material>
struct Parametrisation {
  Vector start, lower, upper;
  std::function<Material(const Vector&)> material;
};

template <typename Material>
Vector residuals(const Parametrisation<Material>& p, const Vector& x, const std::vector<Target>& targets) {
  const Material material = p.material(x);
  Vector r;
  r.reserve(3 * targets.size() + x.size());
  for (const Target& t : targets) {
    const glm::dvec3 f = material.value(t.d);
    for (int c = 0; c < 3; ++c) r.push_back(t.weight * (std::log(std::max(f[c], tiny)) - t.log_value[c]));
  }
  for (std::size_t k = 0; k < x.size(); ++k) r.push_back(prior * (x[k] - p.start[k]));
  return r;
}

double cost(const Vector& r) {
  double sum = 0;
  for (const double x : r) sum += x * x;
  return sum;
}

/// Solves the symmetric positive definite a x = b by Cholesky; false if it is not definite.
bool solve(std::vector<Vector> a, Vector& b) {
  const std::size_t n = b.size();
  for (std::size_t j = 0; j < n; ++j) {
    for (std::size_t k = 0; k < j; ++k) a[j][j] -= a[j][k] * a[j][k];
    if (!(a[j][j] > 0)) return false;
    a[j][j] = std::sqrt(a[j][j]);
    for (std::size_t i = j + 1; i < n; ++i) {
      for (std::size_t k = 0; k < j; ++k) a[i][j] -= a[i][k] * a[j][k];
      a[i][j] /= a[j][j];
    }
  }
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t k = 0; k < i; ++k) b[i] -= a[i][k] * b[k];
    b[i] /= a[i][i];
  }
  for (std::size_t i = n; i-- > 0;) {
    for (std::size_t k = i + 1; k < n; ++k) b[i] -= a[k][i] * b[k];
    b[i] /= a[i][i];
  }
  return true;
}

struct Minimum {
  Vector x;
  double cost;
};

/// Normal equations by forward differences, steps into the bounds.
template <typename Material>
void linearise(const Parametrisation<Material>& p, const std::vector<Target>& targets, const Vector& x, const Vector& r, std::vector<Vector>& normal,
               Vector& gradient) {
  const std::size_t n = x.size();
  std::vector<Vector> columns;
  for (std::size_t k = 0; k < n; ++k) {
    Vector moved = x;
    const double step = 1e-6 * std::max(1.0, std::abs(x[k]));
    moved[k] += moved[k] + step <= p.upper[k] ? step : -step;
    Vector column = residuals(p, moved, targets);
    for (std::size_t i = 0; i < column.size(); ++i) column[i] = (column[i] - r[i]) / (moved[k] - x[k]);
    columns.push_back(std::move(column));
  }
  normal.assign(n, Vector(n));
  gradient.assign(n, 0.0);
  for (std::size_t k = 0; k < n; ++k) {
    for (std::size_t l = 0; l <= k; ++l)
      for (std::size_t i = 0; i < r.size(); ++i) normal[k][l] += columns[k][i] * columns[l][i];
    for (std::size_t i = 0; i < r.size(); ++i) gradient[k] += columns[k][i] * r[i];
  }
  for (std::size_t k = 0; k < n; ++k)
    for (std::size_t l = k + 1; l < n; ++l) normal[k][l] = normal[l][k];
}

/// Levenberg-Marquardt; a parameter at its bound with the gradient pointing outwards stays there.
template <typename Material>
Minimum minimise(const Parametrisation<Material>& p, const std::vector<Target>& targets) {
  Vector x = p.start;
  for (std::size_t k = 0; k < x.size(); ++k) x[k] = std::clamp(x[k], p.lower[k], p.upper[k]);
  Vector r = residuals(p, x, targets), gradient;
  double best = cost(r), damping = 1e-3;
  std::vector<Vector> normal;
  for (int iteration = 0; iteration < 200; ++iteration) {
    linearise(p, targets, x, r, normal, gradient);
    double gained = 0;
    for (int attempt = 0; attempt < 12 && gained == 0; ++attempt) {
      std::vector<Vector> damped = normal;
      Vector step(x.size());
      for (std::size_t k = 0; k < x.size(); ++k) {
        const bool held = (x[k] <= p.lower[k] && gradient[k] > 0) || (x[k] >= p.upper[k] && gradient[k] < 0);
        for (std::size_t l = 0; held && l < x.size(); ++l) damped[k][l] = damped[l][k] = 0;
        step[k] = held ? 0 : -gradient[k];
        damped[k][k] = held ? 1 : normal[k][k] * (1 + damping) + 1e-12;
      }
      Vector moved = x;
      if (solve(std::move(damped), step)) {
        for (std::size_t k = 0; k < x.size(); ++k) moved[k] = std::clamp(x[k] + step[k], p.lower[k], p.upper[k]);
        Vector trial = residuals(p, moved, targets);
        if (const double c = cost(trial); c < best) {
          gained = best - c;
          best = c;
          x = std::move(moved);
          r = std::move(trial);
        }
      }
      damping = gained > 0 ? damping / 5 : damping * 5;
    }
    if (gained <= 1e-9 * best) break;
  }
  return {x, best};
}

/// The best of several starts.
template <typename Material>
Material best_of(const std::vector<Parametrisation<Material>>& starts, const std::vector<Target>& targets) {
  Minimum best{{}, std::numeric_limits<double>::infinity()};
  for (const auto& p : starts)
    if (Minimum m = minimise(p, targets); m.cost < best.cost) best = std::move(m);
  return starts.front().material(best.x);
}

/// Narrowest lobes last; at least one, a broad black one, where the model has none.
std::vector<brdf::CookTorrance::Lobe> lobes_of(const brdf::CookTorrance& model) {
  auto lobes = model.lobes;
  std::sort(lobes.begin(), lobes.end(), [](const auto& a, const auto& b) { return a.m > b.m; });
  if (lobes.empty()) lobes.push_back({.ks = glm::dvec3(0.0), .m = 0.5, .r = 0.04});
  return lobes;
}

/// One more parameter.
template <typename Material>
void add(Parametrisation<Material>& p, double start, double lower, double upper) {
  p.start.push_back(start);
  p.lower.push_back(lower);
  p.upper.push_back(upper);
}

constexpr double log_floor = -14;  // ln of the smallest colour and roughness: 8e-7

double log_of(double x) { return std::log(std::max(x, 1e-6)); }

/// Starts of a base under a clear coat, from every lobe and two degrees of metal; parameters: logarithm of the base's colour, metal, its
/// roughness, weight and roughness of the coat.
template <typename Material>
std::vector<Parametrisation<Material>> coated_starts(const brdf::CookTorrance& model) {
  const auto lobes = lobes_of(model);
  std::vector<Parametrisation<Material>> starts;
  for (const auto& lobe : lobes)
    for (const double metallic : {0.2, 0.8}) {
      Parametrisation<Material> p;
      for (int c = 0; c < 3; ++c) add(p, log_of(std::min(model.kd[c] + 3 * lobe.ks[c], 0.9)), log_floor, 0);
      add(p, metallic, 0, 1);
      add(p, std::sqrt(lobe.m), 0.01, 1);
      add(p, 0.9, 0, 1);
      add(p, std::sqrt(lobes.back().m), 0.01, 1);
      starts.push_back(std::move(p));
    }
  return starts;
}

}  // namespace

brdf::LuxCoreCarPaint refit_luxcore(const brdf::CookTorrance& model) {
  using Paint = brdf::LuxCoreCarPaint;
  auto lobes = lobes_of(model);
  if (lobes.size() > 3) lobes.erase(lobes.begin(), lobes.end() - 3);
  std::vector<Parametrisation<Paint>> starts;
  for (const double narrower : {0.7, 1.0}) {
    Parametrisation<Paint> p;
    for (int c = 0; c < 3; ++c) add(p, log_of(model.kd[c]), log_floor, 0);
    for (const auto& lobe : lobes) {
      // Same value at the peak: ks / m^2 there, ks / (4 m^2) here.
      for (int c = 0; c < 3; ++c) add(p, log_of(4 * lobe.ks[c] * narrower * narrower), log_floor, 0);
      add(p, std::log(lobe.m * narrower), std::log(1e-4), 0);
      add(p, lobe.r, 0, 1);
    }
    p.material = [n = lobes.size()](const Vector& x) {
      Paint paint;
      for (int c = 0; c < 3; ++c) paint.kd[c] = std::exp(x[static_cast<std::size_t>(c)]);
      for (std::size_t i = 0; i < n; ++i) {
        for (std::size_t c = 0; c < 3; ++c) paint.lobes[i].ks[static_cast<int>(c)] = std::exp(x[3 + 5 * i + c]);
        paint.lobes[i].m = std::exp(x[3 + 5 * i + 3]);
        paint.lobes[i].r = x[3 + 5 * i + 4];
      }
      return paint;
    };
    starts.push_back(std::move(p));
  }
  return best_of(starts, targets_of(model));
}

brdf::GltfClearcoat refit_gltf(const brdf::CookTorrance& model) {
  auto starts = coated_starts<brdf::GltfClearcoat>(model);
  for (auto& p : starts)
    p.material = [](const Vector& x) { return brdf::GltfClearcoat{{std::exp(x[0]), std::exp(x[1]), std::exp(x[2])}, x[3], x[4], x[5], x[6]}; };
  return best_of(starts, targets_of(model));
}

brdf::OpenPbr refit_open_pbr(const brdf::CookTorrance& model) {
  auto starts = coated_starts<brdf::OpenPbr>(model);
  for (auto& p : starts) {
    for (int c = 0; c < 3; ++c) add(p, 0.8, 0, 1);
    add(p, 1.5, 1.01, 3);
    p.material = [](const Vector& x) {
      brdf::OpenPbr m;
      m.base_color = {std::exp(x[0]), std::exp(x[1]), std::exp(x[2])};
      m.base_metalness = x[3], m.specular_roughness = x[4], m.coat_weight = x[5], m.coat_roughness = x[6];
      m.specular_color = {x[7], x[8], x[9]};
      m.coat_ior = x[10];
      return m;
    };
  }
  return best_of(starts, targets_of(model));
}

}  // namespace lacquer::fit
