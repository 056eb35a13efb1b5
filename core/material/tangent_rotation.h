// The shading tangent of a material turned about the normal.
#pragma once

#include <cmath>

#include "base/numeric.h"
#include "base/vec.h"

namespace matiere {

template <class R>
struct TangentRotation {
    R c{R(1)}, s{};

    /// Quarter turns are exact.
    static TangentRotation make(R degrees) {
        const double turns = std::remainder(double(degrees), 360.0);
        const double quarter = std::nearbyint(turns / 90.0);
        const double rest = (turns - 90.0 * quarter) * kPi<double> / 180.0;
        const R a = R(std::cos(rest)), b = R(std::sin(rest));
        switch (int(quarter) & 3) {
            case 1:
                return {-b, a};
            case 2:
                return {-a, -b};
            case 3:
                return {b, -a};
            default:
                return {a, b};
        }
    }

    Vec3<R> to_tangent(Vec3<R> w) const { return {c * w.x + s * w.y, c * w.y - s * w.x, w.z}; }
    Vec3<R> from_tangent(Vec3<R> w) const { return {c * w.x - s * w.y, c * w.y + s * w.x, w.z}; }
};

}  // namespace matiere
