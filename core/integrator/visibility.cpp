#include "integrator/visibility.h"

#include <cmath>

namespace matiere {

namespace {

/// Surfaces that one shadow ray may pass.
constexpr int kMaxPassed = 1000;

/// Walks through what does not stop light: interfaces hidden inside a medium of higher priority,
/// and what opacity and null parts let pass.
Spectrumf walk(const Scene& scene, Ray ray, InteriorStack inside, Counters& counters) {
    Spectrumf result(1.0F);
    const Vec3f end = ray.origin + ray.direction;
    const bool infinite = ray.t_max > 1;
    for (int i = 0; i < kMaxPassed; ++i) {
        ++counters.shadow_rays;
        const RayHit hit = scene.intersect(ray);
        const float scale = length(ray.direction);
        result *= absorb(scene, inside, hit.missed() ? ray.t_max * scale : hit.t * scale);
        if (hit.missed() || result.is_black()) return result;
        const SurfaceHit s = scene.surface(ray, hit);
        if (s.material < 0) return {};
        const bool interior = scene.materials()[s.material].has_interior;
        const bool entering = dot(s.point.n_g, ray.direction) < 0;
        if (!interior || !cross_interface(scene.materials(), s.material, entering, inside).hidden) {
            result *= scene.materials().pass_through(s.material, s.point.texture_point());
            if (result.is_black()) return {};
        }
        if (interior) move_through(scene, s, entering, inside, counters);
        ray.origin = offset_origin(s.point.p, s.error, s.point.n_g, ray.direction);
        if (!infinite) ray.direction = end - ray.origin;
    }
    return {};
}

}  // namespace

Spectrumf absorb(const Scene& scene, const InteriorStack& inside, float distance) {
    const int medium = inside.current();
    if (medium < 0) return Spectrumf(1.0F);
    return scene.materials()[medium].sigma_t.map(
        [distance](float sigma) { return sigma > 0 ? std::exp(-sigma * distance) : 1.0F; });
}

void move_through(const Scene& scene, const SurfaceHit& s, bool entering, InteriorStack& inside,
                  Counters& counters) {
    if (entering)
        inside.enter(s.material, scene.materials()[s.material], counters);
    else
        inside.leave(s.material, counters);
}

Spectrumf transmittance(const Scene& scene, const SurfaceHit& s, const LightSample& light,
                        InteriorStack inside, Counters& counters) {
    const Ray ray = shadow_ray(s, light);
    if (scene.shadows_walk()) return walk(scene, ray, inside, counters);
    ++counters.shadow_rays;
    if (scene.occluded(ray)) return {};
    if (inside.empty()) return Spectrumf(1.0F);
    return absorb(scene, inside, light.infinite ? kInfinity<float> : length(ray.direction));
}

}  // namespace matiere
