#pragma once

#include <array>
#include <string>

#include "libbrdf/brdf.h"

/// Material models of renderers that a fit can be exported to, as their authors publish them. Values f_r in 1/sr, without the cosine,
/// both directions above the horizon.
namespace lacquer::brdf {

/// LuxCore `carpaint` (src/slg/materials/carpaint.cpp, sampling functions in sampling/sampling.cpp of LuxCoreRender 2): diffuse part and
/// three lobes ks D G F / (4 cos cos), D and G after Schlick with roughness m^2 (D is GGX with alpha = m), F Schlick with r. No
/// absorption (ka, d = 0). LuxCore clamps kd and ks to [0, 1].
struct LuxCoreCarPaint {
  struct Lobe {
    glm::dvec3 ks{0.0};
    double m = 0.1, r = 0.5;
  };
  glm::dvec3 kd{0.0};
  std::array<Lobe, 3> lobes;
  glm::dvec3 value(const Directions& d) const;
  /// Properties of a scene's .scn file: scene.materials.NAME.type = "carpaint" and so on.
  std::string text(const std::string& name, const std::string& comment) const;
};

/// glTF 2.0 metallic-roughness material (Appendix B) below KHR_materials_clearcoat: GGX with alpha = roughness^2, separable Smith G, Schlick F;
/// the coat has F0 = 0.04 at the angle of the view and takes from the base what it reflects. Not reciprocal: wo is the view.
struct GltfClearcoat {
  glm::dvec3 base_color{0.5};
  double metallic = 0.5, roughness = 0.5, clearcoat = 1.0, clearcoat_roughness = 0.1;  ///< all [0, 1]
  glm::dvec3 value(const Directions& d) const;
  std::string text(const std::string& name, const std::string& comment) const;  ///< a .gltf file with one material and nothing else
};

/// MaterialX `open_pbr_surface` (OpenPBR 1.1), the part that this export uses: metal (GGX, height-correlated Smith G, F82-tint) mixed with a
/// Lambertian by base_metalness, below a coat with exact dielectric Fresnel. coat_darkening 0, specular_ior = coat_ior (the dielectric base has
/// no interface of its own). The light that the coat takes from the base, in the specification its directional albedo, is here its
/// Fresnel reflectance at the angle of the view, which is right for a smooth coat.
struct OpenPbr {
  glm::dvec3 base_color{0.5}, specular_color{1.0};  ///< [0, 1]; specular_color tints the metal at 82 degrees
  double base_metalness = 0.5, specular_roughness = 0.5, coat_weight = 1.0, coat_roughness = 0.1;  ///< [0, 1]
  double coat_ior = 1.6;                                                                        ///< [1, 3]
  glm::dvec3 value(const Directions& d) const;
  std::string text(const std::string& name, const std::string& comment) const;  ///< a .mtlx file
};

/// A material behind the common interface.
template <typename Material>
class MaterialBrdf final : public Brdf {
 public:
  MaterialBrdf(const Material& material, std::string description) : material_(material), description_(std::move(description)) {}
  std::string description() const override { return description_; }

 private:
  std::optional<glm::dvec3> do_value(const Directions& d, const Footprint<double>& /*footprint*/) const override { return material_.value(d); }
  Material material_;
  std::string description_;
};

}  // namespace lacquer::brdf
