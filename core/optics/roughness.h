// The only maps between the words for roughness, and the one rule for the smooth limit.
#pragma once

#include <algorithm>

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

template <class R>
constexpr bool is_delta_alpha(R alpha_x, R alpha_y) {
    return std::max(alpha_x, alpha_y) < R(kDeltaAlpha);
}

}  // namespace matiere
