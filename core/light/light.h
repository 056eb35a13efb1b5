// All lights of a scene behind one choice. Lights that stand somewhere are found by a tree as seen
// from the point they light; the tree, the lights at infinity and the environment are weighed by
// power, half of the choice uniform, so that what is misjudged from a point still gets its share.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>
#include <variant>
#include <vector>

#include "light/area.h"
#include "light/environment.h"
#include "light/light_tree.h"
#include "light/profile.h"
#include "material/material.h"

namespace matiere {

struct PointLight {
    Vec3f position;
    Spectrumf intensity;  ///< W/sr
};

struct DirectionalLight {
    Vec3f direction;  ///< unit, where the light travels
    Spectrumf irradiance;
};

/// A point that shines into a cone, fading out from `cos_inner` to `cos_outer`.
struct SpotLight {
    Vec3f position, direction;  ///< unit, the axis away from the light
    Spectrumf intensity;        ///< W/sr on the axis
    float cos_outer, cos_inner;

    /// Share of the intensity towards a direction: smooth between the two cones, 0 outside.
    float falloff(Vec3f away) const {
        const float c = dot(direction, away);
        if (c <= cos_outer) return 0;
        if (c >= cos_inner) return 1;
        const float t = (c - cos_outer) / (cos_inner - cos_outer);
        return t * t * (3 - 2 * t);
    }
};

/// A point or a spot whose light a measured table spreads; a point's cone is wider than everything.
struct ProfileLight {
    SpotLight spot;  ///< intensity: where the table is 1
    ProfileFrame frame;
    std::shared_ptr<const LightProfile> profile;

    float share(Vec3f away) const {
        const float in_cone = spot.falloff(away);
        return in_cone > 0 ? in_cone * frame.value(*profile, away) : 0;
    }
};

/// A rectangle of constant radiance, lit on the side of its normal.
struct RectangleLight {
    RectangleShape shape;
    Spectrumf radiance;
};

/// A mesh or sphere whose material emits.
struct MeshLight {
    MeshShape shape;
    int material;
};

struct SphereLight {
    SphereShape shape;
    int material;
};

/// The environment takes part in the choice by its index alone; the set holds it.
struct EnvironmentTag {};

using Light = std::variant<PointLight, SpotLight, ProfileLight, DirectionalLight, RectangleLight,
                           MeshLight, SphereLight, EnvironmentTag>;

/// Light arriving at a reference point from one sampled place.
struct LightSample {
    Vec3f wi;           ///< unit, towards the light
    Spectrumf weight;   ///< incident radiance (or irradiance for a delta) over the density
    float pdf = 0;      ///< per solid angle with the choice of the light; 0 for delta lights
    Vec3f p, error, n;  ///< where the shadow ray ends; unused at infinity
    bool infinite = false;
    bool delta = false;
    int light = 0;  ///< index in the set
};

/// Light from a point on a shape; its density is 0 where it cannot reach the reference.
[[gnu::always_inline]] inline LightSample shape_sample(Vec3f reference, const ShapeSample& s,
                                                       const Spectrumf& radiance, bool two_sided) {
    const Vec3f to_light = s.p - reference;
    LightSample out;
    if (!(s.pdf > 0) || (!two_sided && dot(to_light, s.n) >= 0)) return out;
    out.wi = normalize(to_light);
    out.weight = radiance * (1 / s.pdf);
    out.pdf = s.pdf;
    out.p = s.p;
    out.error = s.error;
    out.n = s.n;
    return out;
}

/// Where a camera path met a light by chance.
struct LightHit {
    int light;
    std::uint32_t primitive;
    Vec3f p, n;
};

class LightSet {
 public:
    /// Radius of the scene's bounding sphere, for the power of what is infinitely far. Without
    /// `tree` every light is chosen by its power alone (tests, benchmarks).
    LightSet(std::vector<Light> lights, std::shared_ptr<const EnvironmentLight> environment,
             const MaterialTable& materials, float scene_radius, bool tree = true);

    bool empty() const { return choice_.empty(); }
    const Light& operator[](int i) const { return lights_[std::size_t(i)]; }
    int size() const { return int(lights_.size()); }
    int environment_index() const { return environment_index_; }
    /// What light i is: point, spot, luminaire, directional, rectangle, mesh, sphere or
    /// environment.
    std::string_view kind(int i) const;
    /// Lights without a surface: found by light sampling alone.
    bool has_points() const;
    bool is_one_rectangle() const;
    const EnvironmentLight* environment() const { return environment_.get(); }
    std::shared_ptr<const EnvironmentLight> shared_environment() const { return environment_; }

    /// Samples light for a receiver; nothing where the chosen light cannot reach it.
    std::optional<LightSample> sample(const Receiver& at, const SampleBlock& u) const;
    /// The same where one rectangle is all there is: no choice, and density 0 for nothing.
    [[gnu::always_inline]] LightSample sample_rectangle(Vec3f reference,
                                                        const SampleBlock& u) const {
        const RectangleLight& l = *std::get_if<RectangleLight>(lights_.data());
        return shape_sample(reference, l.shape.sample(reference, u), l.radiance, false);
    }
    /// Density with which `sample` finds the point of a light.
    float pdf(Vec3f reference, const LightHit& hit) const;
    /// Radiance of the environment, which there must be, and the density of `sample` there.
    EnvironmentLight::Seen see_environment(const Receiver& at, Vec3f direction) const;
    /// Radiance leaving a surface light towards the front or the back of its surface.
    Spectrumf emitted(int light, const TexturePoint& at, bool front) const;

 private:
    struct Choice {
        std::size_t light;
        float probability;
    };
    std::optional<Choice> choose(Vec3f reference, std::uint32_t u) const;
    float probability(Vec3f reference, std::size_t light) const;

    std::vector<Light> lights_;
    std::shared_ptr<const EnvironmentLight> environment_;
    const MaterialTable* materials_;
    LightTree tree_;
    DiscreteDistribution choice_;         ///< over `choices_`
    std::vector<std::uint32_t> choices_;  ///< lights; kTree stands for all those in the tree
    std::vector<std::uint32_t> place_;    ///< by light: its index in `choices_`
    int environment_index_ = -1;
    static constexpr std::uint32_t kTree = ~0U;
};

}  // namespace matiere
