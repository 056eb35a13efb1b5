// Orthonormal frames and the trigonometry of the local shading frame (normal = +z).
#pragma once

#include <cmath>

#include "base/vec.h"

namespace matiere {

template <class R>
struct Frame {
    Vec3<R> s{R(1), R(0), R(0)}, t{R(0), R(1), R(0)}, n{R(0), R(0), R(1)};

    /// Any frame about a unit normal (Duff, Burgess, Christensen, Hery, Kensler, Liani, Villemin
    /// 2017).
    static Frame from_normal(Vec3<R> n) {
        const R sign = std::copysign(R(1), n.z);
        const R a = R(-1) / (sign + n.z);
        const R b = n.x * n.y * a;
        return {{R(1) + sign * n.x * n.x * a, sign * b, -sign * n.x},
                {b, sign + n.y * n.y * a, -n.y},
                n};
    }

    /// The frame about n whose s axis is the tangent made orthogonal to n; any frame where the
    /// tangent is (nearly) parallel to n or zero.
    static Frame from_normal_tangent(Vec3<R> n, Vec3<R> tangent) {
        const Vec3<R> s = tangent - n * dot(n, tangent);
        const R l2 = length_squared(s);
        if (!(l2 > R(1e-12) * length_squared(tangent))) return from_normal(n);
        const Vec3<R> unit = s * (R(1) / std::sqrt(l2));
        return {unit, cross(n, unit), n};
    }

    Vec3<R> to_local(Vec3<R> w) const { return {dot(w, s), dot(w, t), dot(w, n)}; }
    Vec3<R> to_world(Vec3<R> l) const { return s * l.x + t * l.y + n * l.z; }
};

using Framef = Frame<float>;

}  // namespace matiere
