// Area-preserving maps from the unit square, and their densities.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "base/numeric.h"
#include "base/vec.h"

namespace matiere {

/// Sine and cosine for |x| <= pi/4 by their Taylor polynomials, to the rounding of R.
template <class R>
inline Vec2<R> cos_sin_eighth(R x) {
    constexpr int kTerms = sizeof(R) == sizeof(float) ? 5 : 9;
    const R x2 = x * x;
    // Reciprocals as constants: a compiler may not turn the division into a product by itself.
    constexpr auto kFactors = [] {
        std::array<Vec2<R>, kTerms + 1> f{};
        for (int k = 1; k <= kTerms; ++k)
            f[std::size_t(k)] = {R(1) / R((2 * k - 1) * (2 * k)), R(1) / R((2 * k) * (2 * k + 1))};
        return f;
    }();
    R c = R(1), s = R(1);
    for (std::size_t k = kTerms; k > 0; --k) {
        c = R(1) - c * (x2 * kFactors[k].x);
        s = R(1) - s * (x2 * kFactors[k].y);
    }
    return {c, x * s};
}

/// Unit disk by concentric squares: neighbours stay neighbours (Shirley & Chiu 1997).
template <class R>
inline Vec2<R> square_to_disk(R u1, R u2) {
    const R a = R(2) * u1 - R(1);
    const R b = R(2) * u2 - R(1);
    if (a == R(0) && b == R(0)) return {R(0), R(0)};
    const bool wide = std::abs(a) > std::abs(b);
    const Vec2<R> turn = cos_sin_eighth(kPi<R> / R(4) * (wide ? b / a : a / b));
    return wide ? Vec2<R>{a * turn.x, a * turn.y} : Vec2<R>{b * turn.y, b * turn.x};
}

/// Direction about +z with density cos / pi [1/sr] (Malley's method). The rim of the disk is lifted
/// by less than the rounding of 1 - r^2, so that no sample lies in the horizon and is lost.
template <class R>
inline Vec3<R> square_to_cosine_hemisphere(R u1, R u2) {
    const Vec2<R> d = square_to_disk(u1, u2);
    constexpr R kRim = std::numeric_limits<R>::epsilon() / R(4);
    return {d.x, d.y, std::sqrt(std::max(R(1) - d.x * d.x - d.y * d.y, kRim))};
}

template <class R>
constexpr R cosine_hemisphere_pdf(R cos_theta) {
    return cos_theta > R(0) ? cos_theta * kInvPi<R> : R(0);
}

/// Uniform direction on the unit sphere.
template <class R>
inline Vec3<R> square_to_sphere(R u1, R u2) {
    const R z = R(1) - R(2) * u1;
    const R r = safe_sqrt(R(4) * u1 * (R(1) - u1));
    const R phi = kTwoPi<R> * u2;
    return {r * std::cos(phi), r * std::sin(phi), z};
}

}  // namespace matiere
