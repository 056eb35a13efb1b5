// The half vector of a pair of directions, with the digits that narrow lobes need.
#pragma once

#include "base/vec.h"

namespace matiere {

template <class R>
struct HalfVector {
    Vec3<R> h;
    R oh{};      ///< o.h = i.h = |o + i| / 2
    R versed{};  ///< 1 - o.h

    /// In double and of exact unit vectors: at grazing the directions nearly cancel, and what is
    /// left decides about narrow lobes. oh = 0 where there is none.
    static HalfVector between(Vec3<R> wo, Vec3<R> wi) {
        const Vec3d o = normalize(vec_cast<double>(wo));
        const Vec3d i = normalize(vec_cast<double>(wi));
        const Vec3d sum = o + i;
        const double length = matiere::length(sum);
        if (!(length > 0.0)) return {};
        const double oh = 0.5 * length;
        return {vec_cast<R>(sum * (1.0 / length)), R(oh), R(versed_between(o, i, oh))};
    }

    /// 1 - (o.h)^2 = |o - i|^2 / 4
    template <class T>
    static T versed_between(Vec3<T> o, Vec3<T> i, T oh) {
        return T(0.25) * length_squared(o - i) / (T(1) + oh);
    }
};

}  // namespace matiere
