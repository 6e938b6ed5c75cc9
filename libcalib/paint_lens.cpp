#include "libcalib/paint_lens.h"

#include <cmath>
#include <glm/geometric.hpp>
#include <glm/mat2x2.hpp>
#include <glm/matrix.hpp>

namespace lacquer::calib {

namespace {

constexpr double step = 1e-3;  // of a prior's sigma

}  // namespace

PaintLens::PaintLens(const GeometryUnknowns& unknowns, const std::vector<double>& x)
    : before_(unknowns.geometry(std::vector<double>(x.size())).camera), now_(unknowns.geometry(x).camera), first_(unknowns.first_lens()) {
  for (std::size_t k = 0; k < unknowns.n_lens(); ++k) {
    std::vector<double> up = x, down = x;
    up[first_ + k] += step;
    down[first_ + k] -= step;
    up_.push_back(unknowns.geometry(up).camera);
    down_.push_back(unknowns.geometry(down).camera);
  }
}

glm::dvec3 PaintLens::moved(const glm::dvec3& sight) const {
  const auto pixel = before_.project(sight);
  const auto ray = pixel ? now_.unproject(*pixel) : std::nullopt;
  return ray ? ray->direction : sight;
}

std::array<glm::dvec3, PaintLens::max_unknowns> PaintLens::turns(const glm::dvec3& sight) const {
  std::array<glm::dvec3, max_unknowns> turns{};
  const glm::dvec3 a = glm::normalize(glm::cross(std::abs(sight.y) < 0.9 ? glm::dvec3(0, 1, 0) : glm::dvec3(1, 0, 0), sight)), b = glm::cross(sight, a);
  constexpr double h = 1e-5;
  const auto right = now_.project(sight + h * a), left = now_.project(sight - h * a), above = now_.project(sight + h * b), below = now_.project(sight - h * b);
  if (!right || !left || !above || !below) return turns;
  const glm::dmat2 sight_from_pixel = glm::inverse(glm::dmat2((*right - *left) / (2 * h), (*above - *below) / (2 * h)));
  for (std::size_t k = 0; k < size(); ++k) {
    const auto up = up_[k].project(sight), down = down_[k].project(sight);
    if (!up || !down) continue;
    const glm::dvec2 d = sight_from_pixel * ((*down - *up) / (2 * step));  // the pixel stays, so the sight gives way
    turns[k] = glm::cross(sight, d.x * a + d.y * b);
  }
  return turns;
}

}  // namespace lacquer::calib
