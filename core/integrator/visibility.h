// What happens to light along a straight segment: extinction in the media it crosses, occlusion.
#pragma once

#include "scene/scene.h"

namespace matiere {

/// A shadow ray ends this part of its length before the light's own surface, several roundings of
/// its ray parameter, so that the light does not shadow itself.
inline constexpr float kShadowEnd = 1 - 0x1p-18F;

inline Ray shadow_ray(const SurfaceHit& s, const LightSample& light) {
    const Vec3f origin = offset_origin(s.point.p, s.error, s.point.n_g, light.wi);
    if (light.infinite) return {origin, light.wi};
    const Vec3f target = offset_origin(light.p, light.error, light.n, -light.wi);
    return {origin, target - origin, kShadowEnd};
}

/// What arrives unscattered (Beer-Lambert) over `distance` metres of the current medium; zero times
/// infinity is no absorption.
Spectrumf absorb(const Scene& scene, const InteriorStack& inside, float distance);

/// Updates the media of a path that passes through the boundary `s` of its material's interior.
void move_through(const Scene& scene, const SurfaceHit& s, bool entering, InteriorStack& inside,
                  Counters& counters);

/// The part of a light sample that reaches the surface point, 0 where it is blocked. `inside` are
/// the media on the light's side of the surface.
Spectrumf transmittance(const Scene& scene, const SurfaceHit& s, const LightSample& light,
                        InteriorStack inside, Counters& counters);

}  // namespace matiere
