// Numeric constants and guarded elementary functions shared by all layers.
#pragma once

#include <algorithm>
#include <cmath>
#include <concepts>
#include <limits>

namespace matiere {

template <class R>
inline constexpr R kPi = R(3.141592653589793238462643383279502884L);
template <class R>
inline constexpr R kInvPi = R(0.318309886183790671537767526745028724L);
template <class R>
inline constexpr R kTwoPi = R(6.283185307179586476925286766559005768L);
template <class R>
inline constexpr R kInfinity = std::numeric_limits<R>::infinity();

/// Largest value below 1: a uniform variate never reaches 1.
template <class R>
inline constexpr R kOneMinusEpsilon = R(1) - std::numeric_limits<R>::epsilon() / 2;

/// Bound on the relative error of n rounded operations: n e / (1 - n e), e half an ulp (Higham
/// 2002).
template <class R>
constexpr R gamma_bound(int n) {
    const R e = std::numeric_limits<R>::epsilon() / 2;
    return R(n) * e / (R(1) - R(n) * e);
}

template <class R>
constexpr R sqr(R x) {
    return x * x;
}

/// Square root of a value that is non-negative in exact arithmetic.
template <class R>
inline R safe_sqrt(R x) {
    return std::sqrt(std::max(x, R(0)));
}

template <class R>
constexpr R lerp(R t, R a, R b) {
    return (R(1) - t) * a + t * b;
}

/// a*b - c*d with at most 1.5 ulp error (Kahan; Jeannerod et al. 2013).
template <std::floating_point R>
inline R difference_of_products(R a, R b, R c, R d) {
    const R cd = c * d;
    const R difference = std::fma(a, b, -cd);
    const R error = std::fma(-c, d, cd);
    return difference + error;
}

}  // namespace matiere
