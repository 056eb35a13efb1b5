// Radiometric values in four lanes. Today lanes 0 to 2 are linear Rec.709 R, G, B and lane 3 is
// zero; wavelengths can take the lanes later, so nothing outside this file may count the lanes.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "base/numeric.h"

namespace matiere {

inline constexpr int kLanes = 4;
/// Lanes in use; the others stay zero and take no part in any max, mean or roulette.
inline constexpr int kActiveLanes = 3;

template <class R>
struct alignas(kLanes * sizeof(R)) Spectrum {
    R v[kLanes]{};

    constexpr Spectrum() = default;
    constexpr explicit Spectrum(R value) : v{value, value, value, R(0)} {}
    constexpr Spectrum(R r, R g, R b) : v{r, g, b, R(0)} {}

    constexpr R operator[](int i) const { return v[i]; }
    constexpr R& operator[](int i) { return v[i]; }

    constexpr Spectrum& operator+=(const Spectrum& b) {
        for (int i = 0; i < kLanes; ++i) v[i] += b.v[i];
        return *this;
    }
    constexpr Spectrum& operator-=(const Spectrum& b) {
        for (int i = 0; i < kLanes; ++i) v[i] -= b.v[i];
        return *this;
    }
    constexpr Spectrum& operator*=(const Spectrum& b) {
        for (int i = 0; i < kLanes; ++i) v[i] *= b.v[i];
        return *this;
    }
    constexpr Spectrum& operator*=(R s) {
        for (int i = 0; i < kLanes; ++i) v[i] *= s;
        return *this;
    }
    constexpr Spectrum operator+(const Spectrum& b) const { return Spectrum(*this) += b; }
    constexpr Spectrum operator-(const Spectrum& b) const { return Spectrum(*this) -= b; }
    constexpr Spectrum operator*(const Spectrum& b) const { return Spectrum(*this) *= b; }
    constexpr Spectrum operator*(R s) const { return Spectrum(*this) *= s; }
    constexpr bool operator==(const Spectrum&) const = default;

    constexpr R max_value() const { return std::max(v[0], std::max(v[1], v[2])); }
    constexpr R min_value() const { return std::min(v[0], std::min(v[1], v[2])); }
    constexpr R average() const { return (v[0] + v[1] + v[2]) * (R(1) / R(kActiveLanes)); }
    /// Rec.709 luminance, the weight of every light and lobe choice.
    constexpr R luminance() const { return R(0.2126) * v[0] + R(0.7152) * v[1] + R(0.0722) * v[2]; }
    constexpr bool is_black() const { return v[0] == R(0) && v[1] == R(0) && v[2] == R(0); }
    /// A lane in proportion to its value, for a uniform u; the values are not negative, one is
    /// above 0.
    constexpr int pick(R u) const {
        const R x = u * (v[0] + v[1] + v[2]);
        const int lane = x < v[0] ? 0 : x < v[0] + v[1] ? 1 : 2;
        if (v[lane] > R(0)) return lane;
        return v[1] > R(0) ? 1 : 0;  // x at a rounded edge
    }
    bool is_finite() const {
        return std::isfinite(v[0]) && std::isfinite(v[1]) && std::isfinite(v[2]);
    }
    constexpr bool has_negative() const { return min_value() < R(0); }

    /// Applies f to the lanes in use; the idle lanes stay zero.
    template <class F>
    constexpr Spectrum map(F&& f) const {
        return {f(v[0]), f(v[1]), f(v[2])};
    }
};

template <class R>
constexpr Spectrum<R> operator*(R s, const Spectrum<R>& a) {
    return a * s;
}

template <class R>
inline Spectrum<R> exp(const Spectrum<R>& a) {
    return a.map([](R x) { return std::exp(x); });
}

template <class To, class From>
constexpr Spectrum<To> spectrum_cast(const Spectrum<From>& a) {
    return {To(a.v[0]), To(a.v[1]), To(a.v[2])};
}

using Spectrumf = Spectrum<float>;
using Spectrumd = Spectrum<double>;

}  // namespace matiere
