// Scattering inside a homogeneous medium, as a path meets it: where, and into which direction.
#pragma once

#include <optional>

#include "base/frame.h"
#include "material/bsdf.h"
#include "optics/free_flight.h"
#include "optics/phase.h"
#include "sampling/sampler.h"
#include "scene/scene.h"

namespace matiere {

/// The numbers of flights lie in blocks beyond all bounces.
inline constexpr std::uint32_t kFirstFlight = 1U << 31;
/// Scattering events inside media after which roulette grows sterner: see `event_limit`.
inline constexpr float kLongWalk = 256;
/// Events inside media after which a path is cut and counted.
inline constexpr int kMediumGuard = 1 << 24;

/// Roulette keeps the throughput of a walk of n events near this. A white medium absorbs nothing,
/// so that its walks, n of which last longer than n events in proportion to n^-1/2, would never end
/// by their throughput. Survival like n^-1/2 makes their mean cost and their variance grow with the
/// logarithm of the longest one only; any exponent larger or smaller makes one of the two diverge.
inline float event_limit(int events) {
    const float n = float(events);
    return n > kLongWalk ? std::sqrt(n / kLongWalk) : 1.0F;
}

/// A phase function where a material is expected: wo and wi point away from the event.
class PhaseBsdf {
 public:
    explicit PhaseBsdf(float g) : g_(g) {}

    BsdfEval<float> eval(Vec3f wo, Vec3f wi, Counters&) const {
        const float p = henyey_greenstein(0.5F * length_squared(wo + wi), g_);
        return {Spectrumf(p), p};
    }
    std::optional<BsdfSample<float>> sample(Vec3f wo, Vec3f u, Counters& counters) const {
        const float down = sample_henyey_greenstein(u.x, g_);  // 1 - cos
        const float sine = std::sqrt(down * (2 - down)), phi = kTwoPi<float> * u.y;
        const Framef onwards = Framef::from_normal(-wo);
        const Vec3f wi =
            normalize(onwards.to_world({sine * std::cos(phi), sine * std::sin(phi), 1 - down}));
        const float p = eval(wo, wi, counters).pdf;
        return BsdfSample<float>{wi, Spectrumf(1.0F), p, kDiffuse | kReflection};
    }

 private:
    float g_;
};

/// The point at distance t on a ray that meets the surface `s` behind it: never so near to the
/// surface that rounding could put it on the other side.
inline Vec3f point_before(const Ray& ray, float t, const SurfaceHit& s) {
    const Vec3f p = ray.origin + ray.direction * t;
    const Vec3f out = dot(s.point.n_g, ray.direction) > 0 ? s.point.n_g : -s.point.n_g;
    const Vec3f rounding = s.error + abs(p) * gamma_bound<float>(3);
    const float deep = dot(out, s.point.p - p), enough = 2 * dot(abs(out), rounding);
    return deep < enough ? p - out * (enough - deep) : p;
}

}  // namespace matiere
