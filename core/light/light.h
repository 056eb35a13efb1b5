// All lights of a scene behind one choice: power-weighted, half of it uniform, so that a light
// whose power is misjudged from where a path stands still gets its share.
#pragma once

#include <cstdint>
#include <optional>
#include <variant>
#include <vector>

#include "light/area.h"
#include "light/environment.h"
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

using Light = std::variant<PointLight, DirectionalLight, RectangleLight, MeshLight, SphereLight,
                           EnvironmentTag>;

/// Light arriving at a reference point from one sampled place.
struct LightSample {
    Vec3f wi;           ///< unit, towards the light
    Spectrumf weight;   ///< incident radiance (or irradiance for a delta) over the density
    float pdf = 0;      ///< per solid angle with the choice of the light; 0 for delta lights
    Vec3f p, error, n;  ///< where the shadow ray ends; unused at infinity
    bool infinite = false;
    bool delta = false;
};

/// Where a camera path met a light by chance.
struct LightHit {
    int light;
    std::uint32_t primitive;
    Vec3f p, n;
};

class LightSet {
 public:
    /// Radius of the scene's bounding sphere, for the power of what is infinitely far.
    LightSet(std::vector<Light> lights, std::optional<EnvironmentLight> environment,
             const MaterialTable& materials, float scene_radius);

    bool empty() const { return choice_.empty(); }
    int size() const { return int(lights_.size()); }
    const EnvironmentLight* environment() const { return environment_ ? &*environment_ : nullptr; }

    /// Samples light at `reference`; nothing where the chosen light cannot reach it.
    std::optional<LightSample> sample(Vec3f reference, const SampleBlock& u) const;
    /// Density with which `sample` finds the point of a light, or a direction of the environment.
    float pdf(Vec3f reference, const LightHit& hit) const;
    float pdf_environment(Vec3f direction) const;
    /// Radiance leaving a surface light towards the front or the back of its surface.
    Spectrumf emitted(int light, Vec2f uv, bool front) const;

 private:
    std::vector<Light> lights_;
    std::optional<EnvironmentLight> environment_;
    const MaterialTable* materials_;
    DiscreteDistribution choice_;
    int environment_index_ = -1;
};

}  // namespace matiere
