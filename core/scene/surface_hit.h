// The point of a hit: position with its rounding error, normals, texture coordinates and tangents.
#pragma once

#include <array>
#include <bit>
#include <cmath>
#include <cstdint>

#include <immintrin.h>

#include "base/features.h"
#include "base/numeric.h"
#include "material/surface_point.h"
#include "shape/mesh.h"
#include "shape/sphere.h"

namespace matiere {

/// A hit with everything a path needs to know about it.
struct SurfaceHit {
    SurfacePoint point;
    Vec3f error;                  ///< absolute bound on the rounding of point.p
    int material = -1;            ///< -1: emits only
    int light = -1;               ///< the light that the surface is, if any
    std::uint32_t primitive = 0;  ///< triangle index
};

/// Texture coordinates and tangents are worth their time where something reads them.
template <Features F>
inline constexpr bool kReadsUv = has(F, kNeedsTextures | kNeedsMaps | kNeedsTangents);

/// Texture coordinates and tangents at the barycentric weights w of a triangle with the edges e1
/// and e2 and the coordinates t at its corners.
inline UvFrame triangle_uv(Vec3f e1, Vec3f e2, const std::array<Vec2f, 3>& t, Vec3f w) {
    UvFrame frame;
    frame.uv = t[0] * w.x + t[1] * w.y + t[2] * w.z;
    const Vec2f d1 = t[1] - t[0], d2 = t[2] - t[0];
    const float det = difference_of_products(d1.x, d2.y, d1.y, d2.x);
    if (det == 0) return frame;
    frame.dpdu = (e1 * d2.y - e2 * d1.y) * std::copysign(1.0F, det);
    frame.dpdv = (e2 * d1.x - e1 * d2.x) * std::copysign(1.0F, det);
    frame.uv_scale = 1 / std::abs(det);
    return frame;
}

/// Both uv sets at the barycentric weights (w0, w1, w2) of triangle (a, b, c).
inline void set_uv(const Mesh& mesh, const std::array<std::uint32_t, 3>& corners, Vec3f w,
                   SurfacePoint& point) {
    point.first.uv = {w.y, w.z};
    if (mesh.uv.empty() && mesh.uv1.empty()) return;
    const auto [a, b, c] = corners;
    const Vec3f p0 = mesh.position(a), e1 = mesh.position(b) - p0, e2 = mesh.position(c) - p0;
    if (!mesh.uv.empty())
        point.first =
            triangle_uv(e1, e2, {mesh.texcoord(a), mesh.texcoord(b), mesh.texcoord(c)}, w);
    if (mesh.uv1.empty()) return;
    point.second =
        triangle_uv(e1, e2, {mesh.texcoord1(a), mesh.texcoord1(b), mesh.texcoord1(c)}, w);
    point.has_second = true;
}

template <Features F>
[[gnu::always_inline]] inline SurfaceHit triangle_surface(const Mesh& mesh, std::uint32_t primitive,
                                                          float u, float v) {
    const auto [a, b, c] = mesh.triangle(primitive);
    const Vec3f p0 = mesh.position(a), p1 = mesh.position(b), p2 = mesh.position(c);
    const float w1 = u, w2 = v, w0 = 1 - w1 - w2;

    SurfaceHit s;
    s.material = mesh.material;
    s.light = mesh.light;
    s.primitive = primitive;
    s.point.p = p0 * w0 + p1 * w1 + p2 * w2;
    s.error = (abs(p0 * w0) + abs(p1 * w1) + abs(p2 * w2)) * gamma_bound<float>(7);
    // Double: the squared length of this cross product leaves float at 1e10 m and 1e-10 m.
    const Vec3f e1 = p1 - p0, e2 = p2 - p0;
    s.point.n_g = vec_cast<float>(normalize(cross(vec_cast<double>(e1), vec_cast<double>(e2))));
    s.point.n_s = s.point.n_g;
    if (!mesh.normals.empty()) {
        const Vec3f n = mesh.normal(a) * w0 + mesh.normal(b) * w1 + mesh.normal(c) * w2;
        const float l2 = length_squared(n);
        if (l2 > 0 && std::isfinite(l2)) {
            const Vec3f unit = n * (1 / std::sqrt(l2));
            s.point.n_s = dot(unit, s.point.n_g) < 0 ? -unit : unit;
        }
    }
    if constexpr (kReadsUv<F>) set_uv(mesh, {a, b, c}, {w0, w1, w2}, s.point);
    return s;
}

/// `hit` is where the ray met the sphere.
template <Features F>
inline SurfaceHit sphere_surface(const Sphere& sphere, int light, std::uint32_t primitive,
                                 Vec3f hit) {
    const Vec3f n = normalize(hit - sphere.center);
    SurfaceHit s;
    s.material = sphere.material;
    s.light = light;
    s.primitive = primitive;
    // Back onto the sphere: the error no longer grows with the distance travelled.
    s.point.p = sphere.center + n * sphere.radius;
    s.error = (abs(sphere.center) + abs(n) * sphere.radius) * gamma_bound<float>(7);
    s.point.n_g = s.point.n_s = n;
    if constexpr (kReadsUv<F>) {
        UvFrame& frame = s.point.first;
        frame.uv = sphere_uv(n);
        frame.dpdu = {n.z, 0, -n.x};
        const float sine = std::sqrt(n.x * n.x + n.z * n.z);
        if (sine > 0) frame.dpdv = Vec3f{-n.x * n.y / sine, sine, -n.z * n.y / sine} * 0.5F;
        frame.uv_scale = kTwoPi<float> * sphere.radius;
    }
    return s;
}

/// std::nextafter towards plus infinity (`up`) or minus infinity: a step of the number's bits.
inline float next_float(float x, bool up) {
    const auto bits = std::bit_cast<std::int32_t>(x);
    const std::int32_t magnitude = bits & 0x7fffffff;
    if (magnitude >= 0x7f800000) {
        if (magnitude > 0x7f800000 || (bits > 0) == up) return x;
    } else if (magnitude == 0) {
        return std::bit_cast<float>(up ? 1 : std::int32_t(0x80000001));
    }
    return std::bit_cast<float>((bits > 0) == up ? bits + 1 : bits - 1);
}

/// A point just outside the rounding error of `p`, on the side of the surface that `w` leaves to
/// (Pharr, Jakob, Humphreys 2023, 6.8.6). Each coordinate is moved to its neighbour in the
/// direction of its offset.
inline Vec3f offset_origin(Vec3f p, Vec3f error, Vec3f n, Vec3f w) {
    using Floats = float __attribute__((vector_size(16)));
    using Bits = std::int32_t __attribute__((vector_size(16)));
    const float d = dot(abs(n), error);
    const Floats offset = Floats{n.x, n.y, n.z, 0} * (dot(w, n) < 0 ? -d : d);
    const Floats moved = Floats{p.x, p.y, p.z, 0} + offset;
    // Masks are 0 or -1, so that this is the sign of the offset; bits grow with the magnitude.
    const Bits direction = (offset < 0.0F) - (offset > 0.0F);
    const Bits bits = std::bit_cast<Bits>(moved), negative = bits >> 31;
    const Bits stepped = bits + ((direction ^ negative) - negative);
    const Bits magnitude = bits & 0x7fffffff;
    const Bits rare = ((magnitude == 0) | (magnitude >= 0x7f800000)) & direction;
    if (_mm_testz_si128(__m128i(rare), __m128i(rare)) != 0) {
        const Floats out = std::bit_cast<Floats>(stepped);
        return {out[0], out[1], out[2]};
    }
    const auto away = [&](int i) {
        return direction[i] == 0 ? moved[i] : next_float(moved[i], direction[i] > 0);
    };
    return {away(0), away(1), away(2)};
}

}  // namespace matiere
