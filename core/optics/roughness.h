// The only maps between the words for roughness, and the one rule for the smooth limit.
#pragma once

#include <algorithm>
#include <cmath>

#include "base/numeric.h"

namespace matiere {

/// Below this alpha a lobe is a delta: D(0)^2 = 1 / (pi alpha^2)^2, which the power heuristic
/// squares, leaves float near grazing. One rule for sample, eval and pdf.
inline constexpr double kDeltaAlpha = 3e-6;

/// `roughness` of JSON is perceptually even: alpha is its square (Burley 2012).
template <class R>
constexpr R alpha_from_roughness(R roughness) {
    return roughness * roughness;
}

/// The exponent m of Blinn-Phong whose lobe has the curvature of alpha: m = 2 / alpha^2 - 2 (Walter
/// et al. 2007, section 5.2); 0 is alpha = 1.
template <class R>
inline R alpha_from_exponent(R exponent) {
    return std::sqrt(R(2) / (exponent + R(2)));
}
inline constexpr double kMaxExponent = 1e12;

template <class R>
constexpr bool is_delta_alpha(R alpha_x, R alpha_y) {
    return std::max(alpha_x, alpha_y) < R(kDeltaAlpha);
}

}  // namespace matiere
