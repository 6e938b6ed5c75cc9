#include <fmt/format.h>

#include <cmath>
#include <limits>

#include "libbrdf/file_error.h"
#include "libbrdf/files.h"
#include "libbrdf/rgl_axes.h"
#include "libbrdf/rgl_spectrum.h"
#include "libbrdf/rgl_warp.h"
#include "libbrdf/tensor_file.h"

namespace lacquer::brdf {

namespace {

constexpr std::uint64_t max_bytes = std::uint64_t{1} << 30;  // the largest published isotropic file has 7 MB
constexpr float max_float = std::numeric_limits<float>::max();

/// 0 where it is undefined (h = n or wi = n), whatever the signs of the zeros, so that the BRDF stays isotropic.
double azimuth(double x, double y) { return x == 0 && y == 0 ? 0.0 : std::atan2(y, x); }

double polar_angle(const glm::dvec3& w) { return std::atan2(std::hypot(w.x, w.y), w.z); }

/// Adaptive parameterisation of Dupuy and Jakob 2018: f_r cos(theta_o) = rgb(s) D(m) / (4 sigma(wi)), s: warped half vector m.
class RglBrdf final : public Brdf {
 public:
  struct Data {
    std::vector<float> theta_i;  ///< radians, ascending
    SquareGrid ndf;              ///< D(m) at (theta_m, phi_m - phi_i)
    SquareGrid sigma;            ///< projected microfacet area at (theta_i, phi_i)
    VisibleNormalWarp warp;      ///< one slice per theta_i
    SquareGrid rgb;              ///< slice = 3 * theta_i + channel
    std::string description;
  };
  explicit RglBrdf(Data data) : data_(std::move(data)) {}

  std::string description() const override { return data_.description; }

 private:
  std::optional<glm::dvec3> do_value(const Directions& d, const Footprint<double>& /*footprint*/) const override {
    const glm::dvec3 m = d.wi + d.wo;
    const double theta_i = polar_angle(d.wi);
    // phi_m - phi_i without the two angles.
    const double phi = azimuth(d.wi.x * m.x + d.wi.y * m.y, d.wi.x * m.y - d.wi.y * m.x);
    const glm::dvec2 u_m(rgl_u_from_theta(polar_angle(m)), rgl_u_from_phi(phi));

    const Blend slices = blend_between(data_.theta_i, theta_i);
    const auto s = data_.warp.invert(u_m, slices);
    const double sigma = data_.sigma.value({rgl_u_from_theta(theta_i), rgl_u_from_phi(0)});
    if (!s || !(sigma > 0)) return std::nullopt;
    const double factor = data_.ndf.value(u_m) / (4 * sigma * d.wo.z);
    glm::dvec3 f;
    for (std::size_t c = 0; c < 3; ++c) {
      const Blend channel{3 * slices.first + c, 3 * slices.second + c, slices.weight};
      // Out-of-gamut spectra left small negative values in the files; the reference loader takes them as 0, and so do we.
      f[static_cast<int>(c)] = std::max(0.0, data_.rgb.value(*s, channel)) * factor;
      if (!std::isfinite(f[static_cast<int>(c)])) return std::nullopt;
    }
    return f;
  }

  Data data_;
};

/// Expected shape of a field; `any` leaves an axis free.
constexpr std::uint64_t any = std::numeric_limits<std::uint64_t>::max();
const TensorFile::Shape& check_shape(const TensorFile& in, const char* field, const TensorFile::Shape& expected) {
  const auto& shape = in.float_shape(field, expected.size());
  for (std::size_t axis = 0; axis < shape.size(); ++axis)
    if (expected[axis] != any && shape[axis] != expected[axis])
      fail_file(in.file(), fmt::format("{}: dimension {}: expected {}, got {}", field, axis, expected[axis], shape[axis]));
  // The last two axes of every grid are the square.
  for (std::size_t axis = shape.size() - 2; axis < shape.size(); ++axis)
    if (shape[axis] < 2) fail_file(in.file(), fmt::format("{}: dimension {}: expected at least 2 nodes, got {}", field, axis, shape[axis]));
  return shape;
}

std::vector<float> ascending(const TensorFile& in, const char* field, float min, float max) {
  std::vector<float> nodes = in.floats(field, 1, min, max);
  if (nodes.empty()) fail_file(in.file(), fmt::format("{}: expected at least one value", field));
  for (std::size_t i = 1; i < nodes.size(); ++i)
    if (!(nodes[i] > nodes[i - 1]))
      fail_file(in.file(), fmt::format("{}: expected ascending values, got {} after {}", field, nodes[i], nodes[i - 1]));
  return nodes;
}

SquareGrid read_grid(const TensorFile& in, const char* field) {
  const auto& shape = check_shape(in, field, {any, any});
  return SquareGrid(in.floats(field, 2, 0, max_float), shape[1], shape[0]);
}

/// The incident directions of the file.
struct Incidence {
  std::vector<float> theta_i;  ///< radians
  std::uint64_t n_phi;         ///< 1 or 2 azimuths; one that varies over two is taken at phi_i = 0, where this class looks it up
  Blend azimuth;

  std::vector<float> at_azimuth_0(std::vector<float> values) const {
    const std::size_t n = values.size() / n_phi;
    for (std::size_t i = 0; n_phi > 1 && i < n; ++i)
      values[i] = static_cast<float>((1 - azimuth.weight) * values[azimuth.first * n + i] + azimuth.weight * values[azimuth.second * n + i]);
    values.resize(n);
    return values;
  }
};

Incidence read_incidence(const TensorFile& in) {
  Incidence incidence;
  incidence.theta_i = ascending(in, "theta_i", 0, 1.5708f);  // files round pi/2 up
  const std::vector<float> phi_i = ascending(in, "phi_i", -6.2832f, 6.2832f);
  if (phi_i.size() > 2)
    fail_file(in.file(), fmt::format("phi_i: {} azimuths, an anisotropic BRDF; expected at most 2, Lacquer's BRDFs are isotropic", phi_i.size()));
  incidence.n_phi = phi_i.size();
  incidence.azimuth = blend_between(phi_i, 0);
  return incidence;
}

VisibleNormalWarp read_warp(const TensorFile& in, const Incidence& incidence) {
  const auto& shape = check_shape(in, "vndf", {incidence.n_phi, incidence.theta_i.size(), any, any});
  const std::size_t nx = shape[3], ny = shape[2];
  std::vector<float> density = in.floats("vndf", 4, 0, max_float);
  // Each slice counts as a density of total 1, so they are scaled before two azimuths are blended.
  for (std::size_t i = 0; incidence.n_phi > 1 && i < density.size(); i += nx * ny) {
    const std::span<float> slice(density.data() + i, nx * ny);
    const double total = bilinear_integral(slice, nx, ny);
    if (!(total > 0)) fail_file(in.file(), fmt::format("vndf: slice {} is 0 everywhere, expected a density", i / (nx * ny)));
    for (float& v : slice) v = static_cast<float>(v / total);
  }
  auto warp = VisibleNormalWarp::create(incidence.at_azimuth_0(std::move(density)), nx, ny);
  if (!warp) fail_file(in.file(), "vndf: one theta_i is 0 everywhere, expected a density");
  return std::move(*warp);
}

SquareGrid read_rgb(const TensorFile& in, const Incidence& incidence) {
  const auto& shape = check_shape(in, "rgb", {incidence.n_phi, incidence.theta_i.size(), 3, any, any});
  return SquareGrid(incidence.at_azimuth_0(in.floats("rgb", 5, -max_float, max_float)), shape[4], shape[3]);
}

SquareGrid read_spectra(const TensorFile& in, const Incidence& incidence) {
  const std::vector<float> wavelengths = ascending(in, "wavelengths", 1, 1e6f);
  // Beyond these the matching functions add less than 1 % to any of X, Y, Z; a narrower file would be extrapolated noticeably.
  if (wavelengths.front() > 400 || wavelengths.back() < 700)
    fail_file(in.file(), fmt::format("wavelengths: {} to {} nm, expected at least 400 to 700 nm for RGB", wavelengths.front(), wavelengths.back()));
  const std::size_t n_waves = wavelengths.size();
  const auto& shape = check_shape(in, "spectra", {incidence.n_phi, incidence.theta_i.size(), n_waves, any, any});
  const std::size_t size = shape[3] * shape[4];
  const std::vector<float> spectra = incidence.at_azimuth_0(in.floats("spectra", 5, -max_float, max_float));
  const std::vector<glm::dvec3> weights = linear_srgb_weights(wavelengths);

  std::vector<float> rgb(3 * incidence.theta_i.size() * size);
  for (std::size_t theta = 0; theta < incidence.theta_i.size(); ++theta)
    for (std::size_t i = 0; i < size; ++i) {
      glm::dvec3 sum(0.0);
      for (std::size_t l = 0; l < n_waves; ++l) sum += weights[l] * double{spectra[(theta * n_waves + l) * size + i]};
      for (std::size_t c = 0; c < 3; ++c) rgb[(3 * theta + c) * size + i] = static_cast<float>(sum[static_cast<int>(c)]);
    }
  return SquareGrid(std::move(rgb), shape[4], shape[3]);
}

}  // namespace

std::unique_ptr<Brdf> read_rgl(const std::filesystem::path& file) {
  const TensorFile in(file, read_bytes(file, max_bytes));
  // RGL's own loaders disagree about files without the Jacobian: some ignore the flag, some obey it.
  if (in.bytes("jacobian") != std::string(1, '\1')) fail_file(file, "jacobian: expected the one value 1");
  const bool spectral = !in.has("rgb") && in.has("spectra");
  if (!spectral && !in.has("rgb")) fail_file(file, "expected a field rgb or the fields spectra and wavelengths, got neither");

  const Incidence incidence = read_incidence(in);
  std::string description = fmt::format("RGL {} measurement {}", spectral ? "spectral" : "RGB", file.string());
  if (in.has("description")) description += fmt::format(" ({})", printable(in.bytes("description")));
  return std::make_unique<RglBrdf>(RglBrdf::Data{
      .theta_i = incidence.theta_i,
      .ndf = read_grid(in, "ndf"),
      .sigma = read_grid(in, "sigma"),
      .warp = read_warp(in, incidence),
      .rgb = spectral ? read_spectra(in, incidence) : read_rgb(in, incidence),
      .description = std::move(description),
  });
}

}  // namespace lacquer::brdf
