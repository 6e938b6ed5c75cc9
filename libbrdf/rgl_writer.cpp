#include "libbrdf/rgl_writer.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <numbers>
#include <span>

#include "libbrdf/error.h"
#include "libbrdf/files.h"
#include "libbrdf/rgl_axes.h"
#include "libbrdf/rgl_ndf.h"
#include "libbrdf/rgl_spectrum.h"
#include "libbrdf/rgl_warp.h"
#include "libbrdf/tensor_file.h"

namespace lacquer::brdf {

namespace {

constexpr double pi = std::numbers::pi;
constexpr std::size_t n_sigma = 128;  // nodes of sigma(theta_i), which is smooth
/// The last incident angle: at 90 degrees the BRDF is not defined. Readers are constant beyond.
constexpr double last_theta_i = 89.5 * pi / 180;

std::vector<float> incident_angles(int n) {
  std::vector<float> theta(static_cast<std::size_t>(n));
  for (int i = 0; i < n; ++i) theta[static_cast<std::size_t>(i)] = static_cast<float>(last_theta_i * i / (n - 1));
  return theta;
}

/// The same row `n` times: isotropic distributions do not depend on the azimuth.
std::vector<float> repeated(std::span<const float> row, std::size_t n) {
  std::vector<float> values;
  for (std::size_t i = 0; i < n; ++i) values.insert(values.end(), row.begin(), row.end());
  return values;
}

/// Density of visible normals over the square: D(m) <wi, m> times the area of a patch, 2 pi^2 u_x sin(theta_m); any scale.
/// A floor keeps every row's sum positive, where readers divide by it.
void visible_normals(std::span<const float> ndf, double theta_i, std::size_t ny, std::span<float> density) {
  const std::size_t nx = ndf.size();
  float largest = 0;
  for (std::size_t y = 0; y < ny; ++y)
    for (std::size_t x = 0; x < nx; ++x) {
      const double u = static_cast<double>(x) / static_cast<double>(nx - 1);
      const double theta = rgl_theta_from_u(u), phi = rgl_phi_from_u(static_cast<double>(y) / static_cast<double>(ny - 1));
      const double cosine = std::cos(theta_i) * std::cos(theta) + std::sin(theta_i) * std::sin(theta) * std::cos(phi);
      const double value = ndf[x] * std::max(cosine, 0.0) * u * std::sin(theta);
      density[y * nx + x] = static_cast<float>(value);
      largest = std::max(largest, density[y * nx + x]);
    }
  constexpr float floor = 1e-4f;
  for (float& v : density) v += floor * largest;
}

/// One incident angle: values [3, n, n] and which of them were evaluated.
struct Slice {
  std::vector<float> rgb;
  std::vector<bool> valid;
};

/// Replaces what is not valid by the mean of its valid neighbours, ring by ring outwards.
void continue_values(Slice& slice, std::size_t n) {
  std::vector<bool> known = slice.valid;
  for (bool changed = true; changed;) {
    changed = false;
    std::vector<std::size_t> ring;
    for (std::size_t i = 0; i < n * n; ++i) {
      if (known[i]) continue;
      const std::size_t x = i % n, y = i / n;
      glm::dvec3 sum(0.0);
      int count = 0;
      const auto add = [&](bool inside, std::size_t j) {
        if (!inside || !known[j]) return;
        for (int c = 0; c < 3; ++c) sum[c] += slice.rgb[static_cast<std::size_t>(c) * n * n + j];
        ++count;
      };
      add(x > 0, i - 1), add(x + 1 < n, i + 1), add(y > 0, i - n), add(y + 1 < n, i + n);
      if (count == 0) continue;
      for (int c = 0; c < 3; ++c) slice.rgb[static_cast<std::size_t>(c) * n * n + i] = static_cast<float>(sum[c] / count);
      ring.push_back(i);
    }
    for (const std::size_t i : ring) known[i] = changed = true;
  }
}

class RglWriter {
 public:
  RglWriter(const Brdf& brdf, const RglOptions& options)
      : brdf_(brdf),
        options_(options),
        n_(static_cast<std::size_t>(options.resolution)),
        ndf_nx_(static_cast<std::size_t>(options.ndf_theta)),
        ndf_ny_(static_cast<std::size_t>(options.ndf_phi)),
        theta_i_(incident_angles(options.n_theta_i)),
        sampling_(sampling_ndf(brdf, ndf_nx_)),
        sigma_(projected_area(sampling_.ndf, n_sigma)),
        ndf_grid_(repeated(sampling_.ndf, 2), ndf_nx_, 2),
        sigma_grid_(repeated(sigma_, 2), n_sigma, 2),
        vndf_(theta_i_.size() * ndf_nx_ * ndf_ny_),
        slices_(theta_i_.size()) {}

  std::vector<TensorField> fields() {
    fill();
    const std::uint64_t nt = theta_i_.size();
    std::vector<TensorField> fields;
    fields.push_back(TensorField::bytes("description", options_.description));
    fields.push_back(TensorField::floats("phi_i", {1}, std::vector<float>{0.0f}));
    fields.push_back(TensorField::floats("theta_i", {nt}, theta_i_));
    fields.push_back(TensorField::floats("ndf", {2, ndf_nx_}, repeated(sampling_.ndf, 2)));
    fields.push_back(TensorField::floats("sigma", {2, n_sigma}, repeated(sigma_, 2)));
    fields.push_back(TensorField::floats("vndf", {1, nt, ndf_ny_, ndf_nx_}, vndf_));
    fields.push_back(TensorField::floats("luminance", {1, nt, n_, n_}, luminance()));
    if (options_.spectral) {
      const std::vector<float> wavelengths = upsampling_wavelengths();
      fields.push_back(TensorField::floats("wavelengths", {wavelengths.size()}, wavelengths));
      fields.push_back(TensorField::floats("spectra", {1, nt, wavelengths.size(), n_, n_}, spectra()));
    } else {
      std::vector<float> rgb;
      for (const Slice& slice : slices_) rgb.insert(rgb.end(), slice.rgb.begin(), slice.rgb.end());
      fields.push_back(TensorField::floats("rgb", {1, nt, 3, n_, n_}, rgb));
    }
    fields.push_back(TensorField::bytes("jacobian", "\1"));
    fields.push_back(TensorField::bytes("valid", packed_mask()));
    return fields;
  }

 private:
  void fill() {
    const std::size_t size = ndf_nx_ * ndf_ny_;
    tbb::parallel_for(std::size_t{0}, theta_i_.size(), [&](std::size_t i) {
      visible_normals(sampling_.warp, theta_i_[i], ndf_ny_, std::span(vndf_).subspan(i * size, size));
    });
    const auto warp = VisibleNormalWarp::create(vndf_, ndf_nx_, ndf_ny_);  // the floor makes every slice positive
    tbb::parallel_for(std::size_t{0}, theta_i_.size(), [&](std::size_t i) {
      slices_[i] = slice(i, *warp);
      continue_values(slices_[i], n_);
    });
    const bool any = std::any_of(slices_.begin(), slices_.end(), [](const Slice& s) { return std::find(s.valid.begin(), s.valid.end(), true) != s.valid.end(); });
    if (!any) throw Error(ErrorCode::input, brdf_.description() + ": has no value in any direction; there is nothing to write");
  }

  /// Values of one incident angle at the nodes: f_r cos(theta_o) 4 sigma / D, with D and sigma as a reader will interpolate them.
  Slice slice(std::size_t i, const VisibleNormalWarp& warp) const {
    Slice slice{std::vector<float>(3 * n_ * n_), std::vector<bool>(n_ * n_)};
    const double theta_i = theta_i_[i];
    const glm::dvec3 wi = direction(theta_i, 0);
    const double sigma = sigma_grid_.value({rgl_u_from_theta(theta_i), 0.5});
    for (std::size_t k = 0; k < n_ * n_; ++k) {
      const glm::dvec2 s(static_cast<double>(k % n_) / static_cast<double>(n_ - 1), static_cast<double>(k / n_) / static_cast<double>(n_ - 1));
      const glm::dvec2 u = warp.sample(s, i);
      const glm::dvec3 m = direction(rgl_theta_from_u(u.x), rgl_phi_from_u(u.y));
      const double cosine = wi.x * m.x + wi.y * m.y + wi.z * m.z;
      const glm::dvec3 wo = 2 * cosine * m - wi;
      if (!(cosine > 0 && wo.z > 0)) continue;
      const auto f = brdf_.value({wi, wo});
      if (!f) continue;
      slice.valid[k] = true;
      const double factor = wo.z * 4 * sigma / ndf_grid_.value(u);
      for (int c = 0; c < 3; ++c) {
        const double value = std::max((*f)[c] * factor, 0.0);
        if (!(value <= std::numeric_limits<float>::max())) slice.valid[k] = false;
        slice.rgb[static_cast<std::size_t>(c) * n_ * n_ + k] = static_cast<float>(value);
      }
    }
    return slice;
  }

  /// What samplers draw directions from; never 0, so that every direction can be drawn.
  std::vector<float> luminance() const {
    std::vector<float> values;
    float largest = 0;
    for (const Slice& slice : slices_)
      for (std::size_t k = 0; k < n_ * n_; ++k) {
        values.push_back(0.2126f * slice.rgb[k] + 0.7152f * slice.rgb[n_ * n_ + k] + 0.0722f * slice.rgb[2 * n_ * n_ + k]);
        largest = std::max(largest, values.back());
      }
    for (float& v : values) v = std::max(v, largest > 0 ? 1e-6f * largest : 1.0f);
    return values;
  }

  std::vector<float> spectra() const {
    const std::vector<glm::dvec3> basis = upsampling_spectra();
    std::vector<float> values;
    for (const Slice& slice : slices_)
      for (const glm::dvec3& b : basis)
        for (std::size_t k = 0; k < n_ * n_; ++k)
          values.push_back(static_cast<float>(b.x * slice.rgb[k] + b.y * slice.rgb[n_ * n_ + k] + b.z * slice.rgb[2 * n_ * n_ + k]));
    return values;
  }

  /// numpy.packbits: the first value is the highest bit.
  std::string packed_mask() const {
    std::string bits((theta_i_.size() * n_ * n_ + 7) / 8, '\0');
    std::size_t at = 0;
    for (const Slice& slice : slices_)
      for (const bool valid : slice.valid) {
        if (valid) bits[at / 8] = static_cast<char>(bits[at / 8] | (0x80 >> (at % 8)));
        ++at;
      }
    return bits;
  }

  const Brdf& brdf_;
  const RglOptions& options_;
  std::size_t n_, ndf_nx_, ndf_ny_;
  std::vector<float> theta_i_;
  SamplingNdf sampling_;
  std::vector<float> sigma_;
  SquareGrid ndf_grid_, sigma_grid_;
  std::vector<float> vndf_;
  std::vector<Slice> slices_;
};

}  // namespace

void RglOptions::validate() const {
  const auto check = [](const char* field, int value, int min, int max) {
    if (value < min || value > max) throw Error(ErrorCode::usage, fmt::format("{}: expected {} to {}, got {}", field, min, max, value));
  };
  check("n_theta_i", n_theta_i, 2, 256);
  check("resolution", resolution, 8, 512);
  check("ndf_theta", ndf_theta, 16, 2048);
  check("ndf_phi", ndf_phi, 8, 512);
}

void write_rgl(const std::filesystem::path& file, const Brdf& brdf, const RglOptions& options) {
  options.validate();
  write_tensor_file(file, RglWriter(brdf, options).fields());
}

}  // namespace lacquer::brdf
