// Small fixed-size vectors. Points, directions and normals share one type; names tell them apart.
#pragma once

#include <cmath>
#include <cstddef>

#include "base/numeric.h"

namespace matiere {

template <class R>
struct Vec2 {
    R x{}, y{};
    constexpr Vec2 operator+(Vec2 b) const { return {x + b.x, y + b.y}; }
    constexpr Vec2 operator-(Vec2 b) const { return {x - b.x, y - b.y}; }
    constexpr Vec2 operator*(R s) const { return {x * s, y * s}; }
};

template <class R>
struct Vec3 {
    R x{}, y{}, z{};

    constexpr R operator[](std::size_t i) const { return i == 0 ? x : (i == 1 ? y : z); }
    constexpr Vec3 operator+(Vec3 b) const { return {x + b.x, y + b.y, z + b.z}; }
    constexpr Vec3 operator-(Vec3 b) const { return {x - b.x, y - b.y, z - b.z}; }
    constexpr Vec3 operator-() const { return {-x, -y, -z}; }
    constexpr Vec3 operator*(R s) const { return {x * s, y * s, z * s}; }
    constexpr Vec3 operator/(R s) const { return {x / s, y / s, z / s}; }
    constexpr Vec3& operator+=(Vec3 b) { return *this = *this + b; }
    constexpr bool operator==(const Vec3&) const = default;
};

template <class R>
constexpr Vec3<R> operator*(R s, Vec3<R> v) {
    return v * s;
}

template <class R>
constexpr R dot(Vec3<R> a, Vec3<R> b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

/// Cross product, each component within 1.5 ulp, so that needle triangles keep a normal.
template <class R>
inline Vec3<R> cross(Vec3<R> a, Vec3<R> b) {
    return {difference_of_products(a.y, b.z, a.z, b.y), difference_of_products(a.z, b.x, a.x, b.z),
            difference_of_products(a.x, b.y, a.y, b.x)};
}

template <class R>
constexpr R length_squared(Vec3<R> v) {
    return dot(v, v);
}

template <class R>
inline R length(Vec3<R> v) {
    return std::sqrt(dot(v, v));
}

template <class R>
inline Vec3<R> normalize(Vec3<R> v) {
    return v * (R(1) / length(v));
}

template <class R>
inline Vec3<R> abs(Vec3<R> v) {
    return {std::abs(v.x), std::abs(v.y), std::abs(v.z)};
}

template <class R>
constexpr R max_component(Vec3<R> v) {
    return std::max(v.x, std::max(v.y, v.z));
}

template <class R>
inline bool is_finite(Vec3<R> v) {
    return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

template <class To, class From>
constexpr Vec3<To> vec_cast(Vec3<From> v) {
    return {To(v.x), To(v.y), To(v.z)};
}

using Vec2f = Vec2<float>;
using Vec3f = Vec3<float>;
using Vec3d = Vec3<double>;

}  // namespace matiere
