// Visible slopes of a Beckmann surface of unit roughness (Heitz & d'Eon 2014): the inverse of
// their cumulative distribution by bracketed Newton steps, and the inverse error function.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/numeric.h"

namespace matiere {

/// The x with erf(x) = y for y in (-1, 1): a closed-form guess (Winitzki 2008) and Newton-Halley
/// steps on erfc, which keeps the tails.
template <class R>
inline R erf_inv(R y) {
    const R a = std::abs(y);
    const R tail = R(1) - a;  // erfc(|x|)
    if (!(tail > R(0))) return std::copysign(R(6), y);
    constexpr R k = R(0.147);
    const R l = std::log(tail * (R(1) + a));
    const R b = R(2) / (kPi<R> * k) + l / R(2);
    R x = std::sqrt(std::max(std::sqrt(b * b - l / k) - b, R(0)));
    constexpr int kSteps = sizeof(R) == sizeof(float) ? 1 : 2;
    for (int i = 0; i < kSteps; ++i) {
        // d/dx erfc = -2/sqrt(pi) exp(-x^2); Halley's correction has the factor x.
        const R step = (std::erfc(x) - tail) * (R(0.886226925452758013649) * std::exp(x * x));
        x += step / (R(1) - x * step);
    }
    return std::copysign(x, y);
}

/// Slope towards a viewer at angle theta whose cotangent is `cot` > 0: its density is proportional
/// to (cot - x) exp(-x^2) for x < cot. `u` in [0, 1).
template <class R>
inline R sample_beckmann_slope(R cot, R u) {
    constexpr R kSqrtPi = R(1.772453850905516027298);
    constexpr R kTail = R(6);  // exp(-36): beyond double's 2^-52 of the mass
    // C(x) = cot sqrt(pi)/2 erfc(-x) + exp(-x^2)/2, a sum of positive terms; C' = (cot - x)
    // exp(-x^2).
    const auto cumulative = [cot](R x, R gauss) {
        return R(0.5) * (cot * kSqrtPi * std::erfc(-x) + gauss);
    };
    R low = -kTail;
    R high = std::min(cot, kTail);
    const R target = u * cumulative(high, std::exp(-high * high));
    // Start at the Gaussian quantile, moved towards the mean slope.
    R x = std::clamp(erf_inv(R(2) * u - R(1)) - R(0.5) / (R(1) + cot), low, high);
    constexpr int kMaxSteps = 60;
    // Halley's steps are cubic: after one this small the next is below rounding. They are measured
    // against the distance to x = cot, where the density vanishes.
    constexpr R kSmallStep = sizeof(R) == sizeof(float) ? R(1e-3) : R(1e-6);
    for (int i = 0; i < kMaxSteps; ++i) {
        const R gauss = std::exp(-x * x);
        const R error = cumulative(x, gauss) - target;
        if (error > R(0))
            high = x;
        else
            low = x;
        const R room = cot - x;
        const R newton = error / (room * gauss);
        const R curved = R(1) + R(0.5) * newton * (R(1) / room + R(2) * x);
        R next = x - newton / std::max(curved, R(0.5));
        if (!(next >= low && next <= high)) next = R(0.5) * (low + high);
        const R moved = std::abs(next - x);
        x = next;
        if (moved <= kSmallStep * std::min(R(1), room)) break;
    }
    return x;
}

}  // namespace matiere
