// Materials in the world: the table of a scene's materials and `Bsdf`, the scattering of one hit.
// The only place that turns world directions into local ones, keeps shading and geometric sides
// apart, and rejects what is not finite, counting why.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "base/frame.h"
#include "base/guard.h"
#include "material/bsdf.h"
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
    Spectrumf sigma_a;             ///< absorption of the medium inside [1/m]
    Spectrumf emission;  ///< radiance emitted where opaque; the texture's mean where textured
    int emission_texture = -1;  ///< -1: constant
    float opacity = 1.0F;       ///< share of the surface that is there; the mean where textured
    int opacity_texture = -1;   ///< -1: constant
    int normal_map = -1, bump_map = -1;  ///< textures; -1: none
    float bump_height = 0.0F;            ///< [m]
    bool passes = false;                 ///< may let light straight through (opacity, null parts)
    std::uint32_t features = 0;          ///< ModelFeature bits
    std::uint8_t lobes = 0;              ///< Lobe bits; all that may occur where textured
    ModelRecipe<float> recipe;
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
    Spectrumf emission(int material, Vec2f uv) const;
    Spectrumf mean_emission(int material) const {
        return (*this)[material].emission * (*this)[material].opacity;
    }
    float opacity(int material, Vec2f uv) const;
    /// The shading normal with the material's normal and bump maps, on the outside.
    Vec3f shading_normal(int material, const SurfacePoint& point) const;
    /// Share of light that a surface lets straight through at a point, at every angle.
    float pass_through(int material, Vec2f uv) const;

 private:
    std::vector<MaterialRecord> records_;
    const TextureTable* textures_;
    std::unique_ptr<TableStore<float>> tables_;
};

/// The scattering of one hit. Made for one wo; small, no heap, no virtual calls.
class Bsdf {
 public:
    /// `wo` is the unit world direction to the viewer; `eta_rel` the index of the medium on the
    /// other side over that on the side of wo, read by interfaces only.
    Bsdf(const MaterialTable& table, int material, const SurfacePoint& point, Vec3f wo,
         float eta_rel);
    Bsdf(const Bsdf&) = delete;  // own_ may point into nested_
    Bsdf& operator=(const Bsdf&) = delete;

    /// f |cos| and pdf for world directions. Zero where geometric and shading sides disagree, so
    /// that no light leaks through. What is not finite is zeroed and counted.
    BsdfEval<float> eval(Vec3f wo, Vec3f wi, Counters& counters) const;
    /// The same, uncounted: what is not finite is returned as it is, for the caller to count.
    BsdfEval<float> eval(Vec3f wo, Vec3f wi) const;

    /// A world direction, or nothing where the sample is absorbed or rejected. u.x picks the lobe.
    /// A kNull sample goes on in the direction -wo: no scattering event.
    std::optional<BsdfSample<float>> sample(Vec3f wo, Vec3f u, Counters& counters) const;

    std::uint8_t lobes() const;
    bool is_delta() const { return (lobes() & (kDiffuse | kGlossy)) == 0; }
    bool may_pass() const { return (lobes() & kNull) != 0; }
    /// The shading frame, its normal on the side of wo.
    const Framef& frame() const { return frame_; }

 private:
    const AnyModel<float>& model() const { return constant_ ? *constant_ : own_; }
    std::optional<BsdfSample<float>> sample_surface(Vec3f wo, Vec3f u, Counters& counters) const;

    Framef frame_;
    Vec3f n_g_;                                  // on the side of wo
    const AnyModel<float>* constant_ = nullptr;  // null: own_
    AnyModel<float> own_;
    NestedModels<float> nested_;  // of own_
    int material_;
    float opacity_ = 1.0F;
    bool black_ = false;  // the back of a one-sided surface
};

}  // namespace matiere
