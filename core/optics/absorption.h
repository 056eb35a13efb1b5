// Absorption along a straight way (Beer-Lambert) and the ways to state it.
#pragma once

#include <cmath>
#include <limits>

#include "base/spectrum.h"

namespace matiere {

/// Absorption coefficient [1/m] from the share of light left after a distance [m]. A share of 0
/// gives the largest finite number, so that a way of length 0 still passes everything.
template <class R>
inline R sigma_a_from_transmittance(R transmittance, R distance) {
    if (!(transmittance > R(0))) return std::numeric_limits<R>::max();
    return std::min(-std::log(transmittance) / distance, std::numeric_limits<R>::max());
}

template <class R>
inline Spectrum<R> sigma_a_from_transmittance(const Spectrum<R>& transmittance, R distance) {
    return transmittance.map([distance](R t) { return sigma_a_from_transmittance(t, distance); });
}

/// Share of light left after `distance` [m] >= 0: exp(-sigma_a d), 1 at d = 0 for every sigma_a.
template <class R>
inline Spectrum<R> beer_lambert(const Spectrum<R>& sigma_a, R distance) {
    if (!(distance > R(0))) return Spectrum<R>(R(1));
    return sigma_a.map([distance](R s) { return s > R(0) ? std::exp(-s * distance) : R(1); });
}

}  // namespace matiere
