// Materials in the world: the table of a scene's materials. `Bsdf` (bsdf_for.h) is the scattering
// of one hit.
#pragma once

#include <memory>
#include <vector>

#include "material/record.h"
#include "material/surface_point.h"

namespace matiere {

/// Plain facts that may be read without a hit.
struct MaterialRecord {
    bool two_sided = true;      ///< scatters on both sides (interfaces always do)
    bool has_interior = false;  ///< bounds a medium; takes part in the interior stack
    bool emissive = false;
    bool delta_only = false;  ///< every lobe is a delta: connecting to lights is useless
    int priority = 0;
    Spectrumf eta_interior{1.0F};  ///< index of the medium inside, per lane
    bool dispersive = false;       ///< the lanes of eta_interior differ
    bool matched = false;          ///< the medium inside takes the index of what surrounds it
    Spectrumf sigma_a, sigma_s;    ///< absorption and scattering of the medium inside [1/m]
    Spectrumf sigma_t;             ///< their sum
    float g = 0;                   ///< mean cosine of its scattering
    bool scatters = false;         ///< sigma_s is not 0
    Spectrumf emission;  ///< radiance emitted where opaque; the texture's mean where textured
    int emission_texture = -1;  ///< -1: constant
    float opacity = 1.0F;       ///< share of the surface that is there; the mean where textured
    int opacity_texture = -1;   ///< -1: constant
    int normal_map = -1, bump_map = -1;  ///< textures; -1: none
    float bump_height = 0.0F;            ///< [m]
    bool passes = false;                 ///< may let light straight through (opacity, null parts)
    std::uint32_t features = 0;          ///< ModelFeature bits
    std::uint8_t lobes = 0;              ///< Lobe bits; all that may occur where textured
    bool made_at_hits = false;           ///< textures or the other medium shape the model
    ModelRecipe<float> recipe;

    bool mapped() const { return normal_map >= 0 || bump_map >= 0; }
    bool textured() const {
        return recipe.textured() || emission_texture >= 0 || opacity_texture >= 0;
    }
};

/// Built once, then immutable and shared by all threads. Keeps a pointer to `textures`.
class MaterialTable {
 public:
    /// Throws SceneError with the JSON pointer of the bad value.
    MaterialTable(const std::vector<MaterialDescription>& descriptions,
                  const TextureTable& textures);

    int size() const { return int(records_.size()); }
    const MaterialRecord& operator[](int i) const { return records_[std::size_t(i)]; }
    const TextureTable& textures() const { return *textures_; }
    /// Emitted radiance at a point [W/m^2/sr], as much of it as opacity leaves.
    Spectrumf emission(int material, const TexturePoint& at) const;
    Spectrumf mean_emission(int material) const {
        return (*this)[material].emission * (*this)[material].opacity;
    }
    float opacity(int material, const TexturePoint& at) const;
    /// The shading normal with the material's normal and bump maps, on the outside.
    Vec3f shading_normal(int material, const SurfacePoint& point) const;
    /// Share of light that a surface lets straight through at a point, at every angle.
    float pass_through(int material, const TexturePoint& at) const;

 private:
    std::vector<MaterialRecord> records_;
    const TextureTable* textures_;
    std::unique_ptr<TableStore<float>> tables_;
};

}  // namespace matiere
