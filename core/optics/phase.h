// The Henyey-Greenstein phase function: how a medium turns light, by one number g, the mean cosine
// of the angle between the old and the new direction of travel (Henyey & Greenstein 1941, Diffuse
// radiation in the galaxy). In double inside: at |g| near 1 the peak is narrower than float angles.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/numeric.h"

namespace matiere {

/// Largest |g|: the peak is then 1.6e5 per steradian, well inside float.
inline constexpr double kMaxPhaseG = 0.999;

/// Density per solid angle [1/sr] where 1 - cos of the angle of deflection is `one_minus_cos`: from
/// that number, not from the cosine, so that the peak of g near 1 keeps its digits.
template <class R>
inline R henyey_greenstein(R one_minus_cos, R g) {
    const double a = double(g);
    const double square = sqr(1 - a) + 2 * a * double(one_minus_cos);
    return R((1 - a) * (1 + a) / (4 * kPi<double> * square * std::sqrt(square)));
}

/// 1 - cos of the angle of deflection for u in [0, 1), with exactly that density (the inverse of
/// the distribution function, brought to a form without 1/g).
template <class R>
inline R sample_henyey_greenstein(R u, R g) {
    const double a = double(g), x = 2 * double(u) - 1;
    // cos = (x + a (x^2 + 3) / 2 + a^2 x + a^3 (x^2 - 1) / 2) / (1 + a x)^2, its distance from 1:
    const double numerator = (1 - x) * sqr(1 - a) * (1 + 0.5 * a * (1 + x));
    return R(std::clamp(numerator / sqr(1 + a * x), 0.0, 2.0));
}

}  // namespace matiere
