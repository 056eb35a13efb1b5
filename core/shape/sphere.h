// Spheres and their ray intersection.
#pragma once

#include <cmath>
#include <optional>

#include "base/vec.h"

namespace matiere {

struct Sphere {
    Vec3f center;
    float radius;
    int material;
};

/// Longitude about +y from +x, and latitude, of a unit normal: both in [0, 1].
inline Vec2f sphere_uv(Vec3f n) {
    const float phi = std::atan2(-n.z, n.x);
    const float theta = std::atan2(std::sqrt(n.x * n.x + n.z * n.z), n.y);
    return {phi < 0 ? phi * (0.5F * kInvPi<float>)+1 : phi * (0.5F * kInvPi<float>),
            1 - theta * kInvPi<float>};
}

struct SphereRay {
    Vec3f origin, direction;
    float t_min, t_max;
};

/// The first distance in (t_min, t_max) at which the ray meets the surface. The discriminant comes
/// from the distance between centre and ray and the roots from the quotient form, so that neither
/// small nor far spheres lose digits to cancellation (Haines, Gunther, Akenine-Moller 2019).
inline std::optional<float> intersect_sphere(const Sphere& s, const SphereRay& ray) {
    const Vec3f f = ray.origin - s.center;
    const float a = dot(ray.direction, ray.direction);
    const float b = -dot(f, ray.direction);
    const Vec3f l = f + ray.direction * (b / a);
    const float quarter = s.radius * s.radius - dot(l, l);
    if (!(quarter >= 0)) return std::nullopt;
    const float distance = length(f);
    const float c = (distance - s.radius) * (distance + s.radius);
    const float q = b + std::copysign(std::sqrt(a * quarter), b);
    const float r0 = q / a, r1 = q == 0 ? r0 : c / q;
    const float near = std::min(r0, r1), far = std::max(r0, r1);
    if (near > ray.t_min && near < ray.t_max) return near;
    if (far > ray.t_min && far < ray.t_max) return far;
    return std::nullopt;
}

}  // namespace matiere
