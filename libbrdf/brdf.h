#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>

#include "libbrdf/cook_torrance.h"
#include "libbrdf/directions.h"

namespace lacquer::brdf {

/// An isotropic BRDF, measured or analytic, in RGB.
class Brdf {
 public:
  virtual ~Brdf() = default;

  /// f_r in 1/sr, without the cosine, R G B. 0 where a direction is at or below the horizon (z <= 0); nullopt where the BRDF
  /// says nothing (a hole of a measured table). Safe to call from many threads.
  /// `footprint`: f_r as an instrument with this spread of half vectors sees it; measured BRDFs, which cannot be
  /// sharpened or blurred, ignore it.
  std::optional<glm::dvec3> value(const Directions& d, const Footprint<double>& footprint = {}) const {
    if (!(d.wi.z > 0 && d.wo.z > 0)) return glm::dvec3(0.0);
    return do_value(d, footprint);
  }

  /// One line for people: kind and file, e.g. "MERL table vch.binary".
  virtual std::string description() const = 0;

 private:
  virtual std::optional<glm::dvec3> do_value(const Directions& d, const Footprint<double>& footprint) const = 0;
};

/// The analytic model behind the common interface.
class CookTorranceBrdf final : public Brdf {
 public:
  explicit CookTorranceBrdf(CookTorrance model) : model_(std::move(model)) {}
  const CookTorrance& model() const { return model_; }
  std::string description() const override { return "Cook-Torrance, " + std::to_string(model_.lobes.size()) + " lobes"; }

 private:
  std::optional<glm::dvec3> do_value(const Directions& d, const Footprint<double>& footprint) const override {
    auto cosines = half_angle_cosines(d);
    cosines.footprint = footprint;
    return model_.value(cosines);
  }
  CookTorrance model_;
};

/// Reads any BRDF file; the format is found from the content, not from the name: table .exr, .csv and .npy, fit.json (also the bare {"kd": [...],
/// "lobes": [...]}), MERL .binary, RGL .bsdf (RGB or spectral), NVIDIA .mbsdf. Throws Error{file} with file, field and what was expected.
std::unique_ptr<Brdf> load_brdf(const std::filesystem::path& file);

}  // namespace lacquer::brdf
